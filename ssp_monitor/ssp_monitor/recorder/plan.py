"""What a recording is asked to do, as one value, and the files that its bag carries."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.bag.split import Split
from ssp_core.errors import InputError
from ssp_monitor.recorder.disk import DiskNeeds
from ssp_monitor.recorder.encoding import VideoChoice
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
    """The run file, and every file of the folder ``task`` beside it, each under its own name.

    Returns:
        (name, media type, data); the run first, then the task's files by name.

    Raises:
        InputError: a file can't be read, has the run's name, or is too large.
    """
    found = [(RUN_NAME, _MEDIA[".yaml"], _read(run_file, MOST_BYTES))]
    folder = run_file.parent / TASK_FOLDER
    left = MOST_BYTES - len(found[0][2])
    files = sorted(path for path in folder.iterdir() if path.is_file()) if folder.is_dir() else []
    for path in files:
        if path.name == RUN_NAME:
            raise InputError(
                "has the name of the run itself", file=path, remedy="take it out of the task"
            )
        data = _read(path, left)
        left -= len(data)
        found.append((path.name, _MEDIA.get(path.suffix, "application/octet-stream"), data))
    return found


def _read(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=path) from error
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


def patterns(texts: tuple[str, ...], field_name: str) -> tuple[Pattern, ...]:
    """Those of some options that are not empty.

    Raises:
        InputError: one is no expression.
    """
    return tuple(Pattern(text, field_name) for text in texts if text)


def split_by(split_mb: float, split_s: float) -> Split | None:
    """When to go on in a new file; 0 is never.

    Raises:
        InputError: a limit is out of range.
    """
    if not split_mb and not split_s:
        return None
    return Split(round(split_mb * MB) if split_mb else None, split_s or None)
