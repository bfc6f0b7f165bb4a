"""``ssp driver``: one of our bridges for AlpaSim, and a check of a policy before it drives here."""

from __future__ import annotations

import json
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Literal

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.host.terminal import on_stop_signals
from ssp_core.options import Number, WholeNumber
from ssp_eval.evaluate.driving import EGODRIVER, bridge_model, driver_options
from ssp_vla_bridge.backend import BACKENDS, parse_options
from ssp_vla_bridge.egodriver.options import DEADLINE_S, FORWARD_CAMERA, read_options

_MOST_PORT = 65535


@click.group()
def driver() -> None:
    """Serve drivers for AlpaSim, and check policies that were written for it.

    \b
    For example:
      ssp driver serve opencv_baseline --port 50051
      ssp driver check grpc://127.0.0.1:50051
    """


@driver.command()
@click.argument("bridge", metavar="NAME[=JSON]")
@click.option(
    "--port",
    type=WholeNumber(0, _MOST_PORT),
    default=50051,
    show_default=True,
    help="0: any free one.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--mode",
    type=click.Choice(["alpasim", "carla"]),
    default="alpasim",
    show_default=True,
    help="Revision assumed for a client that declares none: AlpaSim's own, or the one before.",
)
@click.option("--camera", default="", help="Camera to use if a client declares several.")
@click.option(
    "--sessions",
    type=WholeNumber(1, 64),
    default=8,
    show_default=True,
    help="Concurrent sessions; each has its own process.",
)
@click.option(
    "--models",
    "models_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File (ssp.models/1) whose models NAME may be.",
)
@click.option("--tls-certificate", default="", metavar="FILE", help="Certificate (PEM).")
@click.option("--tls-key", default="", metavar="FILE", help="Its key (PEM).")
@click.option("--insecure", is_flag=True, help="Plain text on a host that isn't loopback.")
def serve(
    bridge: str,
    port: int,
    host: str,
    mode: Literal["alpasim", "carla"],
    camera: str,
    sessions: int,
    models_file: Path | None,
    tls_certificate: str,
    tls_key: str,
    insecure: bool,
) -> int:
    """Serve the bridge NAME as an EgodriverService until interrupted.

    \b
    For example:
      ssp driver serve opencv_baseline --port 50051
      ssp driver serve 'mine={"backend": "http", "url": "http://127.0.0.1:8300"}'
    """
    if bool(tls_certificate) != bool(tls_key):
        raise click.UsageError("--tls-certificate and --tls-key go together")
    # gRPC is loaded where it is used.
    from ssp_vla_bridge.egodriver.policy import BridgePolicy
    from ssp_vla_bridge.egodriver.server import Listening, serving

    name, _, options_text = bridge.partition("=")
    options = driver_options(name, parse_options(options_text, name), models_file, sorted(BACKENDS))
    if EGODRIVER in options:
        raise InputError(
            "is served already",
            field="NAME",
            value=name,
            remedy="name one of our bridges, such as opencv_baseline",
        )
    policy = BridgePolicy(bridge_model(name, options), camera, sessions)
    at = Listening(host, port, tls_certificate, tls_key, insecure)
    over = threading.Event()
    with on_stop_signals(lambda _: over.set()), serving(policy, mode, at) as address:
        console.out.print(f"{name} listens on {address}", markup=False)
        over.wait()
    return 0


@driver.command()
@click.argument("url", metavar="grpc://HOST:PORT")
@click.option(
    "--deadline",
    "deadline_s",
    type=Number(0),
    default=DEADLINE_S,
    show_default=True,
    help="Time limit for each question with all of its calls, s.",
)
@click.option(
    "--revision", type=click.Choice(["1", "2"]), help="Revision of a server that declares none."
)
@click.option(
    "--camera", default=FORWARD_CAMERA, show_default=True, help="Declared name of the camera."
)
@click.option("--tls", default="", metavar="FILE", help="Certificates (PEM) of the server.")
@click.option("--drive-insecure", is_flag=True, help="Plain text to a host that isn't loopback.")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check(
    url: str,
    deadline_s: float,
    revision: str | None,
    camera: str,
    tls: str,
    drive_insecure: bool,
    as_json: bool,
) -> int:
    """Check a policy before it drives; each finding says what was seen and how to mend it.

    Exit status 1 if a part fails.
    """
    arguments = {"url": url, "deadline_s": deadline_s, "camera": camera, "tls": tls}
    arguments["revision"] = None if revision is None else int(revision)
    options = read_options({**arguments, "insecure": drive_insecure}, "check")
    # gRPC is loaded where it is used.
    from ssp_vla_bridge.egodriver.check import check_policy
    from ssp_vla_bridge.egodriver.tls import read_certificates

    if tls:
        read_certificates(tls, "--tls")
    findings = check_policy(options)
    if as_json:
        click.echo(json.dumps([asdict(one) for one in findings]))
    else:
        for one in findings:
            word = "pass" if one.passed else "fail"
            console.out.print(f"{word}  {one.name:10} {one.seen}", markup=False)
            if one.mend:
                console.out.print(f"{'':16} mend: {one.mend}", markup=False)
    return 0 if all(one.passed for one in findings) else 1
