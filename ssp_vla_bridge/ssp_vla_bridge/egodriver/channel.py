"""The connection to an EgodriverService: its security and its limits."""

from __future__ import annotations

import grpc  # type: ignore[import-untyped] # has no types

from ssp_vla_bridge.egodriver.options import EgodriverOptions, target_of
from ssp_vla_bridge.egodriver.tls import read_certificates

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
    credentials = grpc.ssl_channel_credentials(read_certificates(options.tls, "tls"))
    return grpc.secure_channel(target, credentials, options=settings)


def limits() -> list[tuple[str, int]]:
    """Return gRPC's settings for the size of messages."""
    return [
        ("grpc.max_send_message_length", MOST_BYTES),
        ("grpc.max_receive_message_length", MOST_BYTES),
    ]
