"""The frames of a recording as scenes of its states, of a simulated session or of a live one."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ssp_core.bag.reader import BagReader, object_states
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cdr.steps import decode_tick
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute
from ssp_core.run_file.model import Camera, RunSpec
from ssp_eval.data.provenance import Provenance
from ssp_eval.recordings.states import STATE_AGE_S
from ssp_ot_controller.camera.frames import Odometer
from ssp_ot_controller.camera.redraw import Redrawing
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene

IMAGE, TICK = absolute(CAMERA_IMAGE), absolute(WORLD_TICK)
_STATE_AGE_NS = seconds_to_ns(STATE_AGE_S)


@dataclass(frozen=True)
class Recorded:
    """A recording that can be drawn anew.

    Args:
        frames_ns: stamps of its frames, rising, each once.
    """

    bag: BagReader
    facts: Provenance
    run: RunSpec
    camera: Camera
    frames_ns: tuple[int, ...]


def read_recorded(bag: BagReader, facts: Provenance) -> Recorded:
    """The recording that is drawn anew.

    Raises:
        InputError: it is no session with states and frames, or was drawn anew or is a twin itself.
    """
    if facts.twin is not None or facts.drawn is not None:
        made = facts.twin if facts.drawn is None else facts.drawn.text
        raise InputError(
            f"isn't as it was recorded: {made}", file=bag.path,
            remedy="give the recording that it was made of",
        )  # fmt: skip
    run = facts.run
    if run is None or run.camera is None:
        raise InputError(
            "is no session with a camera, so that nothing says where a camera would stand",
            file=bag.path, field="camera", remedy="give a recording of `ssp run`",
        )  # fmt: skip
    frames_ns = sorted({peek_stamp_ns(message.data) for message in bag.messages([IMAGE])})
    if not frames_ns:
        raise InputError("has no frames, whose stamps are drawn", file=bag.path, field=IMAGE)
    return Recorded(bag, facts, run, run.camera, tuple(frames_ns))


def scenes(recorded: Recorded) -> Iterator[tuple[int, Scene]]:
    """The stamp and the scene of each frame that has a state of the VUT, in order, each once."""
    if TICK in recorded.bag.topics:
        return _of_world(recorded)
    return _of_reports(recorded)


def _of_world(recorded: Recorded) -> Iterator[tuple[int, Scene]]:
    """Scenes of a simulated world, step by step, as its camera saw them."""
    camera, wanted = Redrawing(recorded.run), set(recorded.frames_ns)
    for message in recorded.bag.messages([TICK]):
        try:
            tick = decode_tick(message.data)
        except ValueError as error:
            raise InputError(f"holds a message that is none: {error}", file=recorded.bag.path,
                             field=TICK) from error  # fmt: skip
        scene = camera.see(tick.step, tick.stamp_ns, tick.objects)
        if scene is not None and tick.stamp_ns in wanted:
            wanted.remove(tick.stamp_ns)
            yield tick.stamp_ns, scene


def _of_reports(recorded: Recorded) -> Iterator[tuple[int, Scene]]:
    """Scenes of what VUT and object targets reported, each carried on to the frame's stamp."""
    run = recorded.run
    ids = [run.vut.id, *(target.id for target in run.targets)]
    found = object_states(recorded.bag, ids)
    rows = {name: _Reports([s for s in states if s.is_finite]) for name, states in found.items()}
    odometer, indicators = Odometer(), Indicators(run.road)
    for stamp_ns in recorded.frames_ns:
        known = [rows[name].at(stamp_ns) for name in sorted(rows)]
        states = tuple(state for state in known if state is not None)
        vut = next((state for state in states if state.object_id == run.vut.id), None)
        if vut is None:
            continue
        odometer.update(states)
        blinking = indicators.update(states, stamp_ns)
        yield stamp_ns, Scene(run.road, vut, states, odometer.snapshot(), blinking)


class _Reports:
    """The reports of one object by time."""

    def __init__(self, states: Sequence[ObjectState]) -> None:
        by_stamp = {state.stamp_ns: state for state in states}
        self._stamps_ns = sorted(by_stamp)
        self._states = [by_stamp[stamp_ns] for stamp_ns in self._stamps_ns]

    def at(self, stamp_ns: int) -> ObjectState | None:
        """The newest report, carried on; None: there is none, or it is too old."""
        index = bisect_right(self._stamps_ns, stamp_ns) - 1
        if index < 0 or stamp_ns - self._stamps_ns[index] > _STATE_AGE_NS:
            return None
        return self._states[index].extrapolated(stamp_ns)
