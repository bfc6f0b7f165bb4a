"""The task of a recording, as one value, and the files that its bag carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ssp_core.bag.writing.split import Split
from ssp_core.errors import InputError, not_read
from ssp_monitor.recorder.disk import DiskNeeds
from ssp_monitor.recorder.encoding import VideoChoice, video_choice
from ssp_monitor.recorder.topics import Pattern, Selection, TopicSpec

RUN_NAME = "run.yaml"
TASK_FOLDER = "task"
# Of one file and of all together; maps are the large ones.
MOST_BYTES = 64 << 20

_MEDIA = {
    ".json": "application/json",
    ".jsonl": "application/jsonl",
    ".yaml": "application/yaml",
    ".yml": "application/yaml",
    ".xml": "application/xml",
    ".xodr": "application/xml",
}

Attachment = tuple[str, str, bytes]


def run_attachments(run_file: Path) -> list[Attachment]:
    """Return the run file, and every file of the folder ``task`` beside it, under their own names.

    Returns:
        (name, media type, data); the run first, then the task's files by name.

    Raises:
        InputError: a file can't be read, has the run's name, or is too large.
    """
    attachments = [(RUN_NAME, _MEDIA[".yaml"], _read(run_file, MOST_BYTES))]
    folder = run_file.parent / TASK_FOLDER
    left = MOST_BYTES - len(attachments[0][2])
    files = sorted(path for path in folder.iterdir() if path.is_file()) if folder.is_dir() else []
    for path in files:
        if path.name == RUN_NAME:
            raise InputError(
                "has the name of the run itself", file=path, remedy="take it out of the task"
            )
        data = _read(path, left)
        left -= len(data)
        attachments.append((path.name, _MEDIA.get(path.suffix, "application/octet-stream"), data))
    return attachments


def _read(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise not_read(path, error) from error
    if len(data) > most:
        raise InputError(
            f"is too large: run and task together may have {MOST_BYTES >> 20} MiB in a bag",
            file=path,
            remedy="compile for a smaller map",
        )
    return data


QUEUE_MB = 256
# Enough to end a run, to close the bag and to copy a file or two.
RESERVE_MB = 200
MB = 1_000_000


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """One recording.

    Args:
        selection: what is recorded of the graph.
        topics: that are recorded in any case.
        attachments: for the bag.
        simulated_time: messages are dated by their own stamps.
        split: when to go on in a new file, None for never.
        video: which pictures become video, None for none.
        queue_bytes: what may wait for the disk.
        lost_limit: messages that may be lost in a valid recording.
        run_id: of the run, None for a recording without one.
        alone: names of topics that have one publisher.
    """

    bag_dir: Path
    selection: Selection
    needs: DiskNeeds
    topics: tuple[TopicSpec, ...] = ()
    attachments: tuple[Attachment, ...] = field(default=(), repr=False)
    simulated_time: bool = False
    split: Split | None = None
    video: VideoChoice | None = None
    queue_bytes: int = QUEUE_MB * MB
    lost_limit: int = 0
    run_id: str | None = None
    alone: frozenset[str] = frozenset()


def options_plan(options: Mapping[str, Any], bag_dir: Path, called: str) -> RecordingPlan:
    """Return the recording that options mean, those of a command line or a node's parameters.

    Args:
        options: ``all``, ``include`` and ``exclude`` (a text or several), ``most_topics``,
            ``split_mb``, ``split_s``, ``queue_mb``, ``reserve_mb``, ``video``, ``video_topics``.
        bag_dir: new folder of the bag.
        called: what an option is called towards people, with ``{}`` for its name.

    Raises:
        InputError: one is no expression, no codec or out of range.
    """

    def patterns(option: str) -> tuple[Pattern, ...]:
        texts = (options[option],) if isinstance(options[option], str) else options[option]
        return tuple(Pattern(text, called.format(option)) for text in texts if text)

    split_mb, split_s = options["split_mb"], options["split_s"]
    size = round(split_mb * MB) if split_mb else None
    return RecordingPlan(
        bag_dir=bag_dir,
        selection=Selection(
            everything=options["all"],
            include=patterns("include"),
            exclude=patterns("exclude"),
            most=options["most_topics"],
        ),
        needs=DiskNeeds(options["reserve_mb"] * MB),
        split=Split(size, split_s or None) if split_mb or split_s else None,
        video=video_choice(options["video"] or "", options["video_topics"]),
        queue_bytes=options["queue_mb"] * MB,
    )
