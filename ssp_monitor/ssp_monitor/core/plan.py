"""What a recording is asked to do, as one value."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.bag.split import Split
from ssp_monitor.core.attachments import Attachment
from ssp_monitor.core.disk import DiskNeeds
from ssp_monitor.core.encoding import VideoChoice
from ssp_monitor.core.pattern import Pattern
from ssp_monitor.core.selection import Selection
from ssp_monitor.core.topics import TopicSpec

QUEUE_MB = 256
# Enough to end a run, to close the bag and to copy a file or two.
RESERVE_MB = 200
MB = 1_000_000


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """One recording.

    Args:
        bag_dir: to be made.
        selection: what is recorded of the graph.
        needs: of the disk.
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
