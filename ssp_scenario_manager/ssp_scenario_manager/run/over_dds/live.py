"""A live session as ``ssp run --mode live`` starts it: which nodes run here, with what."""

from __future__ import annotations

import math
import os
import shlex
import socket
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import click

from ssp_core import names
from ssp_core.addresses import resolve
from ssp_core.bag.seals.declaration import load_declaration
from ssp_core.errors import HostError, InputError
from ssp_core.host.environment import finds_sessions
from ssp_core.host.terminal import own_command
from ssp_core.options import Number
from ssp_core.run_file.model import RunSpec

LEAST_FIXES = ("fix", "sbas", "gbas")
# Of variables whose values are paths.
_PATHS = ("_FILE", "_KEYSTORE")
_OPTIONS = (
    click.option(
        "--body",
        "bodies",
        multiple=True,
        metavar="ID=ADDRESS",
        help="With --mode live: body of an object that this host controls, udp://HOST:PORT, "
        "iso22133://HOST[:PORT][?report=FILE] or mirror; may be repeated. Other hosts "
        "control objects without one.",
    ),
    click.option(
        "--odometry",
        metavar="TOPIC",
        help="With --mode live: Odometry of the VUT's GNSS/INS, from which its states are made. "
        "[default: another node publishes the states]",
    ),
    click.option(
        "--navsat",
        metavar="TOPIC",
        help="Instead of --odometry: NavSatFix of the VUT's GNSS/INS; the site needs a datum.",
    ),
    click.option("--heading", metavar="TOPIC", help="With --navsat: Imu, orientation against ENU."),
    click.option(
        "--velocity",
        metavar="TOPIC",
        help="With --navsat: TwistStamped or TwistWithCovarianceStamped. [default: differences of "
        "positions]",
    ),
    click.option(
        "--least-fix",
        type=click.Choice(LEAST_FIXES),
        help="With --navsat: least fix type of a position. [default: gbas, as RTK is]",
    ),
    click.option(
        "--unit",
        type=(Number(), Number(), Number()),
        metavar="FORWARD LEFT YAW",
        help="With --odometry or --navsat: position of the unit: m ahead of the rear axle, m left "
        "of the centre line, rad turned to the left. [default: 0 0 0]",
    ),
    click.option(
        "--remap",
        "remappings",
        multiple=True,
        metavar="FROM:=TO",
        help="With --mode live: subscribe to one of our topics under the name that a driver "
        "publishes; may be repeated.",
    ),
    click.option(
        "--wait",
        is_flag=True,
        help="With --mode live: load the run and begin it on the word `start`. [default]",
    ),
    click.option(
        "--start-at-once",
        is_flag=True,
        help="With --mode live: arm and start without a person's word, for unattended hosts.",
    ),
    click.option(
        "--declared",
        type=click.Path(path_type=Path, dir_okay=False),
        metavar="FILE",
        help="With --mode live: a named person's declaration of what takes part, sealed with the "
        "bag.",
    ),
)


def live_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a live session; each comes as one more argument."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@dataclass(frozen=True, slots=True)
class LiveSetup:
    """The parts of a live session that run on this host, beside manager and recorder.

    Args:
        bodies: by object id, of those that are led from here: an address, or ``mirror``.
        receiver: topics of the VUT's GNSS/INS by the names of vut_adapter's parameters, and its
            least_fix; empty: somebody else publishes ``vut/state``.
        unit: where the unit sits: forward m, left m, yaw to the left rad.
        remappings: ``from:=to``, for all nodes.
        start_at_once: the run begins without a person's word.
        declared: file with a person's word on what takes part; None: none is given.
    """

    bodies: dict[str, str]
    receiver: dict[str, str] = field(default_factory=dict)
    unit: tuple[float, float, float] = (0.0, 0.0, 0.0)
    remappings: tuple[str, ...] = ()
    start_at_once: bool = False
    declared: Path | None = None

    @classmethod
    def of_options(cls, mode: str, options: dict[str, Any]) -> LiveSetup | None:
        """Return the setup that was asked for, None for a simulated run.

        Raises:
            click.UsageError: an option without the one that it belongs to, or not of its form.
        """
        flags = {"bodies": "body", "remappings": "remap"}
        option_names = [
            f"--{flags.get(name, name)}".replace("_", "-")
            for name, value in options.items()
            if value
        ]
        if mode != "live":
            if option_names:
                raise click.UsageError(f"{', '.join(option_names)}: only with --mode live")
            return None
        if options["wait"] and options["start_at_once"]:
            raise click.UsageError("--wait waits for a person's word, --start-at-once for none")
        receiver = _receiver(options)
        if options["unit"] is not None and not receiver:
            raise click.UsageError("--unit says where the unit of --odometry or --navsat sits")
        if options["unit"] is not None and not all(map(math.isfinite, options["unit"])):
            raise click.UsageError("--unit takes finite numbers")
        bodies: dict[str, str] = {}
        for entry in options["bodies"]:
            object_id, equals, address = entry.partition("=")
            if not (object_id and equals and address) or "," in entry:
                raise click.UsageError(f"--body {entry}: write ID={names.BODY_ADDRESSES}")
            if address != "mirror" and not (names.udp_body(address) or names.iso_body(address)):
                raise click.UsageError(f"--body {entry}: is no body; write {names.BODY_ADDRESSES}")
            if object_id in bodies:
                raise click.UsageError(f"--body {object_id}: it has a body already")
            bodies[object_id] = address
        for rule in options["remappings"]:
            old, separator, new = rule.partition(":=")
            if not (old and separator and new) or old.startswith("__"):
                raise click.UsageError(f"--remap {rule}: write OURS:=THEIRS")
        return cls(
            bodies,
            receiver,
            options["unit"] or (0.0, 0.0, 0.0),
            tuple(options["remappings"]),
            options["start_at_once"],
            options["declared"],
        )

    def check(self, spec: RunSpec) -> None:
        """Refuse, with an InputError, a setup that doesn't fit the run.

        That is a body of an object that the run doesn't have, or on a host without an address,
        places on the Earth of a site that lies nowhere, or a person's word that doesn't fit.
        """
        if "navsat" in self.receiver and spec.datum is None:
            raise InputError(
                "is missing: --navsat gives latitudes, and the site's position is unknown",
                field="datum",
                value=spec.site,
                remedy="give the site file a datum and compile again (docs/sites.md)",
            )
        speak_iso = [i for i, at in self.bodies.items() if at.startswith("iso22133:")]
        if speak_iso and spec.datum is None:
            raise InputError(
                "is missing: where the site lies is unknown, and objects that speak ISO 22133 "
                "need its latitude and longitude",
                field="datum",
                value=f"{spec.site}, for {', '.join(sorted(speak_iso))}",
                remedy="give the site file a datum and compile again (docs/sites.md)",
            )
        if self.declared is not None:
            load_declaration(self.declared, spec)
        object_ids = [target.id for target in spec.targets]
        for object_id in self.bodies:
            if object_id not in object_ids:
                raise InputError(
                    "is no object of this run",
                    field="--body",
                    value=object_id,
                    remedy=f"choose {', '.join(object_ids)}",
                )
        if unreachable := list(self._unreachable()):
            raise InputError.of_all(unreachable, None)

    def _unreachable(self) -> Iterator[InputError]:
        """Find bodies on hosts that can't exist or have no address."""
        for object_id, address in self.bodies.items():
            at = names.udp_body(address) or names.iso_body(address)
            try:
                if at is not None:
                    resolve(at[0], at[1] or 0, socket.SOCK_DGRAM)
            except HostError as error:
                yield InputError(
                    str(error),
                    field="--body",
                    value=f"{object_id}={address}",
                    remedy="correct the name, give the address itself, or make this host know it",
                )

    def parameters(self, run_file: Path, bag: Path) -> dict[str, dict[str, object]]:
        """Return the nodes of this host by name, in starting order, each with its parameters."""
        parameters_by_node: dict[str, dict[str, object]] = {
            names.MONITOR: {"run_file": run_file, "bag_dir": bag},
        }
        if self.bodies:
            parameters_by_node[names.OBJECT_TARGET] = {
                "run_file": run_file,
                "object_ids": ",".join(sorted(self.bodies)),
                "bodies": ",".join(f"{i}={address}" for i, address in sorted(self.bodies.items())),
            }
        if self.receiver:
            forward_m, left_m, yaw_left_rad = self.unit
            parameters_by_node[names.VUT_ADAPTER] = {
                "run_file": run_file,
                **self.receiver,
                "unit_forward_m": forward_m,
                "unit_left_m": left_m,
                "unit_yaw_left_rad": yaw_left_rad,
            }
        parameters_by_node[names.SCENARIO_MANAGER] = {"run_file": run_file}
        return parameters_by_node


def describe(setup: LiveSetup, spec: RunSpec, run_file: Path, env: dict[str, str]) -> list[str]:
    """List the facts that people must know before a live session, one line each."""
    server = env.get("ROS_DISCOVERY_SERVER")
    discovery = f"discovery server {server}" if server else "no discovery server"
    lines = [
        f"live session in ROS domain {env['ROS_DOMAIN_ID']}, {discovery}, "
        f"DDS profile {Path(env['FASTRTPS_DEFAULT_PROFILES_FILE']).name}"
    ]
    if spec.stand_in:
        lines.append(
            f"{spec.site} is a stand-in site: its fence and limits are those of no proving ground"
        )
    for object_id, address in sorted(setup.bodies.items()):
        who = dict(parse_qsl(address.partition("?")[2])).get("waive", "").strip()
        if who:
            lines.append(
                f"{who} lets {object_id} be armed whatever its probe report lacks, and answers "
                "for its stops"
            )
    elsewhere = [t.id for t in spec.targets if t.id not in setup.bodies]
    if elsewhere:
        lines.append(f"on other hosts: object_target of {', '.join(elsewhere)}, with {run_file}")
    if not setup.receiver:
        lines.append(f"waiting for the VUT on {names.absolute(names.state_topic(spec.vut.id))}")
    lines.append("to see what is connected, in another terminal:")
    lines.append(f"  {doctor_command(setup, run_file, env)}")
    return lines


def doctor_command(setup: LiveSetup, run_file: Path, env: dict[str, str]) -> str:
    """Return the doctor's command for a session, to be pasted into any shell of this host.

    Before it stands whatever this process was given to find others by, and the domain.
    """
    words = [f"{name}={shlex.quote(value)}" for name, value in sorted(_graph(env).items())]
    arguments = ["doctor", "--session", str(run_file)]
    for name in ("odometry", "navsat"):
        if name in setup.receiver:
            arguments += [f"--{name}", setup.receiver[name]]
    for rule in setup.remappings:
        arguments += ["--remap", rule]
    return " ".join([*words, own_command(), *map(shlex.quote, arguments)])


def _graph(env: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a session without which the doctor would be in another graph."""
    variables = {
        name: str(Path(value).absolute()) if name.endswith(_PATHS) else value
        for name, value in env.items()
        if value
        and finds_sessions(name)
        and not name.startswith("RCUTILS_")  # these shape logs
        and value == os.environ.get(name)
    }
    return {**variables, "ROS_DOMAIN_ID": env["ROS_DOMAIN_ID"]}


def _receiver(options: dict[str, Any]) -> dict[str, str]:
    """Return topics of the VUT's GNSS/INS; UsageError for some that don't go together."""
    gnss = ("navsat", "heading", "velocity", "least_fix")
    topics = {name: options[name] for name in ("odometry", *gnss) if options[name] is not None}
    if "odometry" in topics and len(topics) > 1:
        raise click.UsageError("--odometry and --navsat: the VUT has one GNSS/INS")
    if topics and "odometry" not in topics and not {"navsat", "heading"} <= topics.keys():
        raise click.UsageError("--navsat and --heading go together, --velocity and --least-fix too")
    return topics
