"""Parameters of this package's nodes, and the recording that those of ``monitor`` mean."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.credentials import LEAST_TOKEN, TOKEN_VARIABLE
from ssp_core.node_interface import RUN_FILE, Parameter
from ssp_core.run_file.model import load_run
from ssp_core.safety.publishers import expected_publishers
from ssp_monitor.recorder.disk import DiskNeeds, expected_rate
from ssp_monitor.recorder.plan import (
    QUEUE_MB,
    RESERVE_MB,
    RecordingPlan,
    options_plan,
    run_attachments,
)
from ssp_monitor.recorder.topics import MOST_TOPICS, bag_topics, uses_simulated_time
from ssp_monitor.replay.player import FASTEST, SLOWEST

DEFAULT_PORT = 8080

# Beside a run's topics, what everybody says of its own health, where somebody does.
HEALTH = "^/diagnostics$"
_EXPRESSION = "regular expression, which may match anywhere in a name; empty: none"

MONITOR = (
    replace(RUN_FILE, description="the run; its topics are recorded in any case"),
    Parameter("bag_dir", "", "bag to make", text="path of no folder yet", required=True),
    Parameter("all", False, "record every topic of the graph, late ones too"),
    Parameter("include", HEALTH, "record these topics too", text=_EXPRESSION),
    Parameter(
        "exclude",
        "",
        "exclude these topics; the run's own are recorded nevertheless",
        text=_EXPRESSION,
    ),
    Parameter(
        "most_topics",
        MOST_TOPICS,
        "most topics beside the run's own; each takes memory, a warning names the rest",
        most=10_000,
    ),
    Parameter(
        "lost_limit",
        0,
        "messages that may be lost or dropped before the recorder's verdict is invalid_harness; "
        "the manager ends a run at the first one reported to it, whatever this value",
        most=1_000_000_000,
    ),
    Parameter(
        "split_mb", 0.0, "continue in a new file at this size, 1e6 bytes; 0: never", most=1e6
    ),
    Parameter("split_s", 0.0, "continue in a new file after this time, s; 0: never", most=1e6),
    Parameter(
        "queue_mb",
        QUEUE_MB,
        "most data waiting for the disk, 1e6 bytes; above it the least important is dropped first, "
        "and counted",
        least=1,
        most=100_000,
    ),
    Parameter(
        "reserve_mb",
        RESERVE_MB,
        "a run is ended when the disk has less free space than this, 1e6 bytes, or will have in "
        "20 s at the present rate; it begins only with space for its longest duration in addition",
        most=10_000_000,
    ),
    Parameter("video", "", "record images as video; empty: unchanged", text="h264, h265 or empty"),
    Parameter(
        "video_topics",
        "",
        "record only the images of these topics as video",
        text="regular expression; empty: all",
    ),
)

_ANY_RUN = replace(
    RUN_FILE,
    description="the run; without it only data from topics is shown",
    text=f"{RUN_FILE.text}; may be empty",
    required=False,
)
PAGE = (
    _ANY_RUN,
    Parameter("host", "127.0.0.1", "address to listen on", text="address of this host"),
    Parameter("port", DEFAULT_PORT, "port to listen on; 0: any free one", most=65535),
    Parameter(
        "token",
        "",
        f"token that commands need, better given in {TOKEN_VARIABLE}; empty: one is generated",
        text=f"{LEAST_TOKEN} printable ASCII characters at least, no space; or empty",
        secret=True,
    ),
    Parameter("page_rate_hz", 10.0, "snapshots a second, Hz", least=2, most=30),
    Parameter("camera_rate_hz", 5.0, "most pictures a second, Hz", least=2, most=30),
    Parameter(
        "led_by_runner",
        False,
        "take the run's end from standard input, as from `ssp run`; end of input ends the page",
    ),
)
VIEW = (_ANY_RUN,)
REPLAY = (
    Parameter(
        "rate",
        1.0,
        "seconds of the bag played per second; takes effect at once",
        least=SLOWEST,
        most=FASTEST,
        read_only=False,
    ),
)
NODES = {"monitor": MONITOR, "monitor_page": PAGE, "view": VIEW, "replay": REPLAY}


def session_plan(parameters: Mapping[str, Any], full_name: Callable[[str], str]) -> RecordingPlan:
    """Return the recording of one run.

    Args:
        parameters: of the node, by name.
        full_name: under which a topic is heard, its remapping applied.

    Raises:
        InputError: the run file is wrong, or a parameter is.
    """
    run_file = Path(parameters["run_file"])
    run = load_run(run_file)
    topics = bag_topics(run)
    # A topic that is heard under another name is not recorded a second time under that.
    own = {full_name(topic.name) for topic in topics}
    plan = options_plan(parameters, Path(parameters["bag_dir"]), "parameter {}")
    own |= {topic.name for topic in topics}
    return replace(
        plan,
        selection=replace(plan.selection, own=frozenset(own)),
        needs=DiskNeeds(plan.needs.reserve_bytes, run.end.at_latest_s, expected_rate(run)),
        topics=topics,
        attachments=tuple(run_attachments(run_file)),
        simulated_time=uses_simulated_time(run),
        lost_limit=parameters["lost_limit"],
        run_id=run.run_id,
        alone=frozenset(
            names.absolute(topic) for topic, parts in expected_publishers(run).items() if not parts
        ),
    )


def topic_rules(arguments: Sequence[str]) -> list[str]:
    """Select from a process's arguments those that rename topics, and none that renames nodes.

    Args:
        arguments: as in sys.argv, ``-r from:=to`` among them.
    """
    rules = [rule for flag, rule in pairwise(arguments) if flag in ("-r", "--remap")]
    renames = [
        rule for rule in rules if not rule.partition(":=")[0].split(":")[-1].startswith("__")
    ]
    return ["--ros-args", *(word for rule in renames for word in ("-r", rule))] if renames else []
