"""``ssp replay``: publishes a bag."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

import ssp_core
from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.host.environment import live_environment, require_sound, session_environment
from ssp_core.options import Number, WholeNumber, usage_errors
from ssp_monitor.recorder.topics import Pattern
from ssp_monitor.replay.plan import DEFAULT_CLOCK_HZ, ReplayOptions, is_name
from ssp_monitor.replay.player import FASTEST, SLOWEST

_PROFILES = Path(ssp_core.__file__).parent / "config"


def _environment(network: bool) -> dict[str, str]:
    if network:
        return live_environment(_PROFILES / "fastdds_hosts.xml")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    require_sound({"ROS_DOMAIN_ID": domain})
    return session_environment(int(domain), _PROFILES / "fastdds_one_host.xml")


def _remap(ctx: click.Context, param: click.Parameter, rules: tuple[str, ...]) -> dict[str, str]:
    new_names = {}
    for rule in rules:
        recorded, mark, topic = rule.partition(":=")
        if not (recorded and mark and topic):
            raise click.BadParameter(f"{rule!r} is not FROM:=TO", ctx, param)
        if not is_name(names.absolute(topic)):
            raise click.BadParameter(f"{topic!r} is no topic name", ctx, param)
        new_names[recorded] = topic
    return new_names


def _expressions(
    _: click.Context, param: click.Parameter, texts: tuple[str, ...]
) -> tuple[str, ...]:
    with usage_errors():
        for text in texts:
            Pattern(text, param.opts[0])
    return texts


@click.command("replay")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--rate", type=Number(SLOWEST, FASTEST), default=1.0, show_default=True)
@click.option("--start", "start_s", type=Number(0), default=0.0, help="Seconds from the beginning.")
@click.option("--end", "end_s", type=Number(0), help="Seconds from the beginning, where to end.")
@click.option("--loop", is_flag=True, help="Start again at the end.")
@click.option("--paused", is_flag=True, help="Start paused.")
@click.option(
    "--clock",
    "clock_hz",
    type=Number(0, 1000),
    help="Publish /clock at this rate, from the bag's times; 0: none. "
    f"[default: the recorded one, else {DEFAULT_CLOCK_HZ:g}]",
)
@click.option(
    "--topics",
    multiple=True,
    metavar="RE",
    callback=_expressions,
    help="Only these: names, or regular expressions found in names (`ssp bag cut` takes patterns "
    "with * instead). Repeatable.",
)
@click.option(
    "--exclude",
    multiple=True,
    metavar="RE",
    callback=_expressions,
    help="Not these; as --topics. Repeatable.",
)
@click.option(
    "--remap",
    multiple=True,
    metavar="FROM:=TO",
    callback=_remap,
    help="Publish under another name. Repeatable.",
)
@click.option("--commands", is_flag=True, help="Also publish topics that real objects may act on.")
@click.option(
    "--beside-session",
    is_flag=True,
    help="Publish even if a session is under way in this ROS domain.",
)
@click.option(
    "--network", is_flag=True, help="Publish to other hosts too; otherwise to this one only."
)
@click.option(
    "--wait-for",
    type=WholeNumber(0),
    default=0,
    help="Start when each topic has this many subscribers, within 30 s.",
)
@click.option("--json", is_flag=True, help="Print JSON for programs.")
def replay(bag: Path, network: bool, **wishes: Any) -> int:
    """Publish a bag as it was recorded: a bag directory or an .mcap file.

    Topics that may move real objects are left out, and a ROS domain with a session in it is
    refused. The node /ssp/replay offers the services pause, resume, step and step_frame
    (std_srvs/Trigger), and the parameter rate. Ctrl-C ends it with exit status 0.
    """
    environment = _environment(network)
    reader = BagReader(bag)
    from ssp_monitor.ros.replay_node import replay as replay_bag

    return replay_bag(reader, ReplayOptions(**wishes), environment)


def main() -> int:
    """Run the verb for ``ros2 run``, with errors as the command line prints them."""
    from ssp_core.cli import main as ssp

    return ssp(["replay", *sys.argv[1:]])
