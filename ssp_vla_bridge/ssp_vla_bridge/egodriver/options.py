"""The options of a policy behind an EgodriverService; read without gRPC."""

from __future__ import annotations

import ipaddress
from functools import partial
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.run_file.values import Strict

# Of the motion and the frames that precede the first question.
HISTORY_S = 1.7
# The forward camera of AlpaSim's own rigs, by which policies look for it.
FORWARD_CAMERA = "camera_front_wide_120fov"
DEADLINE_S = 10.0
# Options that say how a policy is reached, and nothing of how it is asked.
CONNECTION = {"url", "deadline_s", "tls", "insecure"}


class EgodriverOptions(Strict):
    """A policy behind an EgodriverService, as it is to drive."""

    url: str = Field(description="grpc://HOST:PORT")
    deadline_s: Annotated[float, Field(ge=0.05, le=3600.0)] = Field(
        DEADLINE_S,
        description="wall time for one question with all of its calls, 0.05 to 3600 s; the first "
        "one begins the session",
    )
    tls: str = Field("", description="file of the certificates (PEM) that the server is checked by")
    insecure: bool = Field(False, description="plain text to a host that isn't loopback")
    camera: Annotated[str, Field(min_length=1, max_length=200)] = Field(
        FORWARD_CAMERA, description="name under which the forward camera is declared"
    )
    revision: Literal[1, 2] | None = Field(
        None, description="1 or 2: of a server that declares none; null: by its version"
    )
    control_step_s: Annotated[float, Field(ge=0.001, le=10.0)] = Field(
        0.1, description="from the decision to time_query_us, 0.001 to 10 s"
    )


def read_options(raw_options: dict[str, Any], name: str) -> EgodriverOptions:
    """Return the options of a policy, checked before anything is connected.

    Args:
        raw_options: as a person gave them.
        name: of the driver, for messages.

    Raises:
        InputError: an option is unknown or wrong, or the connection would be open to others.
    """
    try:
        options = parse_model(EgodriverOptions, raw_options, "")
    except InputError as error:
        raise error.each(partial(_of_driver, name)) from error
    target_of(options.url)
    _check_open(options)
    return options


def _of_driver(name: str, error: InputError) -> InputError:
    """Return the refusal of an option with the driver's name, and a remedy by its description."""
    info = EgodriverOptions.model_fields.get((error.field or "").rpartition(".")[2])
    return InputError(
        error.problem,
        field=f"driver {name}.{error.field}",
        value=error.value,
        remedy=error.remedy if info is None else f"give {info.description}",
    )


def target_of(url: str) -> tuple[str, int]:
    """Return host and port of ``grpc://HOST:PORT``.

    Raises:
        InputError: it is no such address.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname or "", parts.port or 0
        rest = parts.path.rstrip("/") or parts.query or parts.fragment or parts.username
    except ValueError:
        parts, host, port, rest = urlsplit(""), "", 0, None
    if parts.scheme != "grpc" or not host or not port or rest:
        # What stands before an @ may be a password, which isn't repeated.
        printable_url = None if "@" in url else url
        raise InputError(
            "is no address of a driver",
            field="url",
            value=printable_url,
            remedy="give such as grpc://127.0.0.1:50051",
        )
    return host, port


def is_loopback(host: str) -> bool:
    """Tell whether only this machine can be behind a host."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _check_open(options: EgodriverOptions) -> None:
    host, _ = target_of(options.url)
    if options.tls or options.insecure or is_loopback(host):
        return
    raise InputError(
        "isn't loopback, and the connection would be neither encrypted nor checked",
        field="url",
        value=options.url,
        remedy="name the server's certificates (PEM) with the option tls, or ask for it by "
        "--drive-insecure",
    )
