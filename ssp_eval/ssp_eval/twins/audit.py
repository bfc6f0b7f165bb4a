"""The differences of a twin from its factual recording, found by comparing both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.states import StateArray, decode_state, decode_states
from ssp_core.cdr.steps import WorldTick, decode_tick
from ssp_core.motion.state import ObjectState
from ssp_core.names import OBJECT_STATES, TF, VUT_ID, absolute, state_topic
from ssp_core.world.transforms import base_frame, decode_transforms
from ssp_eval.twins.changes import MOVED, OF_OBJECT, Change, Kind
from ssp_eval.twins.files import TwinAudit
from ssp_eval.twins.playback import IMAGE, TICK, Picture, World

_ARRAYS = absolute(OBJECT_STATES)
_MOST_REASONS = 5


@dataclass
class Pixels:
    """Counts in what a twin's pictures differ from the factual ones, before JPEG.

    Args:
        object_id: whose image and shadow bound the difference; empty: no object.
    """

    object_id: str
    frames: int = 0
    changed_frames: int = 0
    changed_px: int = 0
    most_px: int = 0
    outside_px: int = 0
    bounded: bool = False

    def take(self, world: World, before: Picture, after: Picture) -> None:
        """Count a frame.

        Args:
            world: states and camera of the twin.
            before: its factual picture.
            after: its picture in the twin.
        """
        self.frames += 1
        red, green, blue = np.moveaxis(before.pixels != after.pixels, 2, 0)
        differs = red | green | blue  # five times faster than any(axis=2)
        count = int(np.count_nonzero(differs))
        self.changed_frames += count > 0
        self.changed_px += count
        self.most_px = max(self.most_px, count)
        camera = world.camera
        change = world.change
        if change is None or change.kind not in OF_OBJECT:
            return
        self.bounded = camera.reaches_no_further
        if count:
            reached = camera.touched(before.scene, self.object_id)
            reached |= camera.touched(after.scene, self.object_id)
            self.outside_px += int(np.count_nonzero(differs & ~reached))


def audit_of(change: Change, factual: BagReader, twin: BagReader, pixels: Pixels) -> TwinAudit:
    """Compare a twin's bag with the factual one.

    Args:
        change: the cause that alone may differ.
        factual: bag of the recording.
        twin: bag of the twin.
        pixels: what was counted when the frames were drawn.
    """
    comparison = _Comparison(change)
    theirs: Iterator[BagMessage] = twin.messages()
    other = next(theirs, None)
    for message in factual.messages():
        if other is not None and message._replace(data=b"") == other._replace(data=b""):
            comparison.pair(message, other)
            other = next(theirs, None)
        else:
            comparison.missing(message.topic)
    if other is not None:
        comparison.fail(f"{other.topic} has a message that the factual recording lacks")
    bounded = change.kind in OF_OBJECT
    if bounded and pixels.bounded and pixels.outside_px:
        comparison.fail(
            f"{pixels.outside_px} changed pixels lie outside the object's image and shadow"
        )
    if not comparison.changed and not comparison.lacking:
        comparison.fail("nothing differs: the change does nothing here")
    elif change.kind is not Kind.HISTORY and not pixels.changed_frames:
        comparison.fail("no frame differs: the change can't be seen here")
    return TwinAudit(
        holds=not comparison.reasons,
        reasons=comparison.reasons,
        frames=comparison.frames,
        frames_redrawn_alike=pixels.frames,
        frames_changed=pixels.changed_frames,
        changed_px=pixels.changed_px,
        most_changed_px=pixels.most_px,
        outside_px=pixels.outside_px if bounded else None,
        outside_judged=bounded and pixels.bounded,
        messages_alike=comparison.alike,
        messages_changed=dict(sorted(comparison.changed.items())),
        messages_missing=dict(sorted(comparison.lacking.items())),
    )


class _Comparison:
    """The comparison of both bags, message by message."""

    def __init__(self, change: Change) -> None:
        history = change.kind is Kind.HISTORY
        self._who = VUT_ID if history else change.object_id
        own = absolute(state_topic(self._who)) if self._who else ""
        self._may_lack = {own, _ARRAYS, TF} if change.kind is Kind.WITHOUT else set()
        self._may_change: dict[str, Callable[[bytes, bytes], bool]] = {}
        if not history:
            self._may_change[IMAGE] = _alike_image
        if change.kind in MOVED or change.kind is Kind.CONTROL:
            self._may_change[TICK] = self._tick
        if change.kind in MOVED or history:
            self._may_change |= {_ARRAYS: self._array, TF: self._poses, own: _alike_state}
        self.reasons: list[str] = []
        self.alike = self.frames = 0
        self.changed: Counter[str] = Counter()
        self.lacking: Counter[str] = Counter()

    def fail(self, reason: str) -> None:
        """Add a reason why the twin doesn't hold; once, and the first few."""
        if reason not in self.reasons and len(self.reasons) < _MOST_REASONS:
            self.reasons.append(reason)

    def missing(self, topic: str) -> None:
        """Take a message that the twin lacks."""
        self.lacking[topic] += 1
        if topic not in self._may_lack:
            self.fail(f"{topic} lacks a message")

    def pair(self, before: BagMessage, after: BagMessage) -> None:
        """Take a message of the factual bag and the twin's with the same place and times."""
        topic = before.topic
        self.frames += topic == IMAGE
        if before.data == after.data:
            self.alike += 1
            return
        self.changed[topic] += 1
        judge = self._may_change.get(topic)
        if judge is None or not judge(before.data, after.data):
            self.fail(f"{topic} differs in more than the change")

    def _others(self, states: tuple[ObjectState, ...]) -> tuple[ObjectState, ...]:
        return tuple(state for state in states if state.object_id != self._who)

    def _tick(self, before: bytes, after: bytes) -> bool:
        one, two = decode_tick(before), decode_tick(after)
        return self._alike_tick(one) == self._alike_tick(two)

    def _alike_tick(self, tick: WorldTick) -> WorldTick:
        return replace(tick, objects=self._others(tick.objects))

    def _array(self, before: bytes, after: bytes) -> bool:
        return self._alike_array(before) == self._alike_array(after)

    def _alike_array(self, data: bytes) -> StateArray:
        array = decode_states(data)
        return replace(array, states=self._others(array.states))

    def _poses(self, before: bytes, after: bytes) -> bool:
        mine = base_frame(self._who)
        one, two = (
            [pose for pose in decode_transforms(data) if pose.child != mine]
            for data in (before, after)
        )
        return one == two


def _alike_state(before: bytes, after: bytes) -> bool:
    one, two = decode_state(before), decode_state(after)
    return (one.object_id, one.stamp_ns, one.sequence) == (
        two.object_id,
        two.stamp_ns,
        two.sequence,
    )


def _alike_image(before: bytes, after: bytes) -> bool:
    one, two = (read_image(COMPRESSED_TYPE, data) for data in (before, after))
    return (one.stamp_ns, one.frame_id, one.format) == (two.stamp_ns, two.frame_id, two.format)
