"""The connection to an EgodriverService: its security and its limits."""

from __future__ import annotations

from pathlib import Path

import grpc  # type: ignore[import-untyped] # has no types

from ssp_core.errors import InputError
from ssp_vla_bridge.egodriver.options import EgodriverOptions, target_of

# Of one message, in either direction.
MOST_BYTES = 16 << 20


def open_channel(options: EgodriverOptions) -> grpc.Channel:
    """Return a channel of its own; nothing is sent before the first call.

    Raises:
        InputError: the certificates can't be read.
    """
    host, port = target_of(options.url)
    target = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    settings = [
        *limits(),
        ("grpc.enable_http_proxy", 0),
        ("grpc.enable_retries", 0),
        ("grpc.use_local_subchannel_pool", 1),
    ]
    if not options.tls:
        return grpc.insecure_channel(target, options=settings)
    credentials = grpc.ssl_channel_credentials(read_pem(options.tls, "tls"))
    return grpc.secure_channel(target, credentials, options=settings)


def limits() -> list[tuple[str, int]]:
    """Return gRPC's settings for the size of messages."""
    return [
        ("grpc.max_send_message_length", MOST_BYTES),
        ("grpc.max_receive_message_length", MOST_BYTES),
    ]


def read_pem(file: str, field: str) -> bytes:
    """Return a file of keys or certificates.

    Args:
        file: its path.
        field: option that names it, for messages.

    Raises:
        InputError: it can't be read, or holds none.
    """
    try:
        data = Path(file).read_bytes()
    except OSError as error:
        raise InputError(
            f"can't be read: {error.strerror}", field=field, value=file, remedy="name a PEM file"
        ) from error
    if b"-----BEGIN " not in data:
        raise InputError("holds no PEM", field=field, value=file, remedy="name a PEM file")
    return data
