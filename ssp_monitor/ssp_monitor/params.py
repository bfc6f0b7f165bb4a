"""Parameters of the node ``monitor``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from rclpy.node import Node

from ssp_core.errors import InputError
from ssp_core.run_spec import load_run
from ssp_monitor.core.attachments import run_attachments
from ssp_monitor.core.disk import DiskNeeds, expected_rate
from ssp_monitor.core.encoding import video_choice
from ssp_monitor.core.plan import MB, QUEUE_MB, RESERVE_MB, RecordingPlan, patterns, split_by
from ssp_monitor.core.selection import MOST_TOPICS, Selection
from ssp_monitor.core.topics import bag_topics, uses_simulated_time

# Beside a run's topics, what everybody says of its own health, where somebody does.
HEALTH = "^/diagnostics$"


@dataclass(frozen=True, slots=True)
class MonitorParams:
    """The parameters as they are given; config/monitor.param.yaml says what each is."""

    run_file: Path
    bag_dir: Path
    all_topics: bool
    include: str
    exclude: str
    most_topics: int
    lost_limit: int
    split_mb: float
    split_s: float
    queue_mb: int
    reserve_mb: int
    video: str
    video_topics: str


def _path(node: Node, name: str) -> Path:
    value = node.declare_parameter(name, "").value
    if not isinstance(value, str) or not value:
        raise InputError(
            "must be a path", field=f"parameter {name}", value=value, remedy=f"give -p {name}:=PATH"
        )
    return Path(value)


def _number(name: str, value: object, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise InputError(
            "is out of range",
            field=f"parameter {name}",
            value=value,
            remedy=f"from {least:g} to {most:g}",
        )
    return float(value)


def read_params(node: Node) -> MonitorParams:
    """Declares and reads the parameters.

    Raises:
        InputError: one is missing or out of range.
    """
    limit = node.declare_parameter("lost_limit", 0).value
    most = node.declare_parameter("most_topics", MOST_TOPICS).value
    queue = node.declare_parameter("queue_mb", QUEUE_MB).value
    reserve = node.declare_parameter("reserve_mb", RESERVE_MB).value
    split_mb = node.declare_parameter("split_mb", 0.0).value
    split_s = node.declare_parameter("split_s", 0.0).value
    return MonitorParams(
        run_file=_path(node, "run_file"),
        bag_dir=_path(node, "bag_dir"),
        all_topics=bool(node.declare_parameter("all", False).value),
        include=str(node.declare_parameter("include", HEALTH).value),
        exclude=str(node.declare_parameter("exclude", "").value),
        most_topics=int(_number("most_topics", most, 0, 10_000)),
        lost_limit=int(_number("lost_limit", limit, 0, 1e9)),
        split_mb=_number("split_mb", split_mb, 0, 1e6),
        split_s=_number("split_s", split_s, 0, 1e6),
        queue_mb=int(_number("queue_mb", queue, 1, 1e5)),
        reserve_mb=int(_number("reserve_mb", reserve, 0, 1e7)),
        video=str(node.declare_parameter("video", "").value),
        video_topics=str(node.declare_parameter("video_topics", "").value),
    )


def session_plan(node: Node, params: MonitorParams) -> RecordingPlan:
    """The recording of one run.

    Raises:
        InputError: the run file is wrong, or a parameter is.
    """
    run = load_run(params.run_file)
    topics = bag_topics(run)
    # A topic that is heard under another name is not recorded a second time under that.
    own = {node.resolve_topic_name(topic.name) for topic in topics}
    return RecordingPlan(
        bag_dir=params.bag_dir,
        selection=Selection(
            everything=params.all_topics,
            include=patterns((params.include,), "parameter include"),
            exclude=patterns((params.exclude,), "parameter exclude"),
            own=frozenset(own | {topic.name for topic in topics}),
            most=params.most_topics,
        ),
        needs=DiskNeeds(params.reserve_mb * MB, run.end.at_latest_s, expected_rate(run)),
        topics=topics,
        attachments=tuple(run_attachments(params.run_file)),
        simulated_time=uses_simulated_time(run),
        split=split_by(params.split_mb, params.split_s),
        video=video_choice(params.video, params.video_topics),
        queue_bytes=params.queue_mb * MB,
        lost_limit=params.lost_limit,
        run_id=run.run_id,
    )


def topic_rules(arguments: Sequence[str]) -> list[str]:
    """Of a process's arguments those that rename topics, and none that renames nodes.

    Args:
        arguments: as in sys.argv, ``-r from:=to`` among them.
    """
    rules = [rule for flag, rule in pairwise(arguments) if flag in ("-r", "--remap")]
    found = [rule for rule in rules if not rule.partition(":=")[0].split(":")[-1].startswith("__")]
    return ["--ros-args", *(word for rule in found for word in ("-r", rule))] if found else []
