"""A recorded session as a world: its states as they were, and as they are with a change.

The bag holds all that a picture depends on (docs/camera.md): the true states of every step, the run
file with road, look, camera and seed, and the stamps of the frames. So nothing is simulated again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.cdr.images import COMPRESSED_TYPE
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cdr.steps import WorldTick, decode_tick
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute
from ssp_core.run_file.model import RunSpec
from ssp_eval.data.provenance import Provenance, read_provenance
from ssp_eval.twins.changes import MOVED, Change, Kind, Series, changed_state, control_object
from ssp_ot_controller.camera.redraw import Picture, Redrawing
from ssp_ot_controller.camera.renderer.scene import Scene

__all__ = ["IMAGE", "TICK", "Factual", "Picture", "World", "decoded", "draw", "read_factual"]

TICK, IMAGE = absolute(WORLD_TICK), absolute(CAMERA_IMAGE)

Decoded = TypeVar("Decoded")


@dataclass(frozen=True)
class Factual:
    """A recorded session of the simulated world.

    Args:
        ticks: every recorded step in order; while the world holds, its first one comes repeatedly.
        frames_ns: stamps of the recorded frames.
    """

    path: Path
    provenance: Provenance
    run: RunSpec
    ticks: tuple[WorldTick, ...]
    frames_ns: frozenset[int]

    @cached_property
    def vut(self) -> Series:
        """True states of the VUT."""
        return self.series(self.run.vut.id)

    def series(self, object_id: str) -> Series:
        """Return the true states of an object.

        Raises:
            InputError: the recording holds none.
        """
        states = [s for tick in self.ticks for s in tick.objects if s.object_id == object_id]
        if not states:
            object_ids = sorted({s.object_id for s in self.ticks[-1].objects} - {self.run.vut.id})
            raise InputError(
                "is no object of the recording",
                file=self.path,
                field="--change",
                value=object_id,
                remedy=f"its objects are {', '.join(object_ids) or 'none'}",
            )
        return Series(states)


def decoded(bag: BagReader, message: BagMessage, decode: Callable[[bytes], Decoded]) -> Decoded:
    """Decode a message.

    Raises:
        InputError: it is none of its type.
    """
    try:
        return decode(message.data)
    except ValueError as error:
        raise InputError(
            f"has an invalid message at {message.log_time_ns} ns: {error}",
            file=bag.path,
            field=message.topic,
            remedy="record the session again",
        ) from error


def read_factual(bag: BagReader) -> Factual:
    """Return the recording that twins are made of.

    Raises:
        InputError: it is no session of the simulated world with this project's camera, or has no
            frames, or is a twin itself.
    """
    facts = read_provenance(bag)
    run, topic = facts.run, bag.topics.get(IMAGE)
    if facts.twin is not None:
        raise InputError(
            f"is a twin: {facts.twin}",
            file=bag.path,
            remedy="change the recording that it was made of",
        )
    if run is None or run.camera is None or run.mode == "live" or TICK not in bag.topics:
        raise InputError(
            "is no simulated session with a camera, so that what the camera would have shown "
            "can't be drawn",
            file=bag.path,
            remedy="give a run of `ssp run`; of any recording the pictures alone can be changed, "
            "with `ssp evaluate --pictures`",
        )
    if run.camera.renderer != "raster" or facts.redrawing is not None:
        raise InputError(
            "was drawn by CARLA, which promises no equal pixels: a twin would differ everywhere",
            file=bag.path,
            field="camera.renderer",
            value="carla",
            remedy="run the task again with --camera raster",
        )
    if topic is None or topic.count == 0 or topic.msgtype != COMPRESSED_TYPE:
        raise InputError(
            "holds no JPEG frames, which alone can be drawn anew byte by byte",
            file=bag.path,
            field=IMAGE,
            value="nothing" if topic is None or topic.count == 0 else topic.msgtype,
            remedy="record the run again with `ssp run`, without --video",
        )
    ticks = tuple(decoded(bag, message, decode_tick) for message in bag.messages([TICK]))
    frames_ns = frozenset(decoded(bag, message, peek_stamp_ns) for message in bag.messages([IMAGE]))
    return Factual(bag.path, facts, run, ticks, frames_ns)


class World:
    """The recorded world with a change.

    Args:
        change: None: the world as it was.

    Raises:
        InputError: the change is about somebody who isn't there, or about the VUT.
    """

    def __init__(self, factual: Factual, change: Change | None) -> None:
        self._factual, self.change = factual, change
        self.camera = Redrawing(factual.run)
        self._added: ObjectState | None = None
        self._own: Series | None = None
        if change is None:
            return
        if change.kind is Kind.CONTROL:
            last_ns = factual.ticks[-1].stamp_ns
            self._added = control_object(change, factual.run.road, factual.vut.at(last_ns))
        elif change.object_id == factual.run.vut.id:
            raise InputError(
                "is the VUT, which drives in a twin as it was recorded",
                file=factual.path,
                field="--change",
                value=change.object_id,
                remedy="change another object",
            )
        elif change.object_id:
            self._own = factual.series(change.object_id)

    def truth(self, tick: WorldTick) -> tuple[ObjectState, ...]:
        """Return the states of a step, by id."""
        change = self.change
        if self._added is not None:
            added = replace(self._added, stamp_ns=tick.stamp_ns)
            return tuple(sorted((*tick.objects, added), key=lambda state: state.object_id))
        if change is None or self._own is None or change.kind not in MOVED:
            return tick.objects
        states = []
        for state in tick.objects:
            if state.object_id != change.object_id:
                states.append(state)
            elif now := changed_state(change, state, self._own, self._factual.vut):
                states.append(now)
        return tuple(states)

    def see(self, tick: WorldTick) -> Scene | None:
        """Take the next step, as the camera does; return its scene, or None without a frame."""
        change, camera_at = self.change, None
        if change is not None and change.kind is Kind.CAMERA:
            then = self._factual.vut.at(tick.stamp_ns - seconds_to_ns(change.value))
            camera_at = replace(then, stamp_ns=tick.stamp_ns)
        return self.camera.see(tick.step, tick.stamp_ns, self.truth(tick), camera_at)


def draw(factual: Factual, worlds: Sequence[World]) -> Iterator[tuple[int, list[Picture]]]:
    """Yield each recorded frame once: its stamp, and its picture in every world."""
    previous_ns: set[int] = set()
    for tick in factual.ticks:
        views = [(world.camera, world.see(tick)) for world in worlds]
        stamp_ns = tick.stamp_ns
        if stamp_ns not in factual.frames_ns or stamp_ns in previous_ns:
            continue
        pictures = [camera.draw(scene, tick.step) for camera, scene in views if scene is not None]
        if len(pictures) == len(worlds):
            previous_ns.add(stamp_ns)
            yield stamp_ns, pictures
