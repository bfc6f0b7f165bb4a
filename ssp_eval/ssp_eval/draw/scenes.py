"""The frames of a recording as scenes of its states, of a simulated session or of a live one."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cdr.steps import decode_tick
from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Road
from ssp_eval.data.provenance import Participants, Provenance
from ssp_eval.recordings.clip import Clip
from ssp_eval.recordings.states import STATE_AGE_S
from ssp_ot_controller.camera.carla_painter import Shooting
from ssp_ot_controller.camera.frames import Odometer
from ssp_ot_controller.camera.redraw import Redrawing
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene

IMAGE, TICK = absolute(CAMERA_IMAGE), absolute(WORLD_TICK)
_STATE_AGE_NS = seconds_to_ns(STATE_AGE_S)


@dataclass(frozen=True)
class DrawableRecording:
    """A recording that can be drawn anew.

    Args:
        frames_ns: stamps of its frames, rising, each once.
    """

    bag: BagReader
    facts: Provenance
    people: Participants
    road: Road
    camera: Camera
    frames_ns: tuple[int, ...]

    @property
    def name(self) -> str:
        """Name the recording, for people."""
        return self.facts.name if self.facts.run is None else self.facts.run.run_id

    def shooting(self, first: Scene) -> Shooting:
        """Describe the world before CARLA's camera.

        An import says nothing of weather and light: it is drawn by day in dry weather.
        """
        if self.facts.run is not None:
            return Shooting.of_run(self.facts.run, self.camera, first.vut.pose)
        return Shooting(
            camera=self.camera,
            frame_s=1.0 / self.camera.rate_hz,
            look=Look(),
            objects={s.object_id: (s.object_class, s.size) for s in first.others},
            vut_size=first.vut.size,
            start=first.vut.pose,
        )


def read_recorded(bag: BagReader, facts: Provenance) -> DrawableRecording:
    """Return the recording that is drawn anew.

    Raises:
        InputError: it is no session with states and frames, or was drawn anew or is a twin itself.
    """
    if facts.twin is not None or facts.redrawing is not None:
        derivation = facts.twin if facts.redrawing is None else facts.redrawing.text
        raise InputError(
            f"isn't as it was recorded: {derivation}",
            file=bag.path,
            remedy="give the recording that it was made of",
        )
    people, road = facts.participants, facts.road
    for part, what, remedy in (
        (people, "no states of VUT and objects", "give a recording with states"),
        (road, "no road", "bind one: `ssp import-bag --site MAP`"),
    ):
        if part is None:
            raise InputError(
                f"has {what}, so that there is nothing to draw", file=bag.path, remedy=remedy
            )
    frames_ns = sorted({peek_stamp_ns(message.data) for message in bag.messages([IMAGE])})
    if not frames_ns:
        raise InputError(
            "has no frames, whose stamps are drawn",
            file=bag.path,
            field=IMAGE,
            remedy="give a recording with camera frames",
        )
    camera = _imported_camera(bag, frames_ns) if facts.run is None else facts.run.camera
    if camera is None or people is None or road is None:
        raise InputError(
            "says nowhere where its camera stood and how it saw",
            file=bag.path,
            field="camera",
            remedy="give a recording of `ssp run`, or import one with its camera's geometry",
        )
    return DrawableRecording(bag, facts, people, road, camera, tuple(frames_ns))


def _imported_camera(bag: BagReader, frames_ns: Sequence[int]) -> Camera | None:
    """Return a pinhole camera like that of an import; CARLA's has square pixels and a central axis.

    Raises:
        InputError: CARLA's camera can't be like it.
    """
    clip = Clip(bag.path)
    try:
        optics = clip.optics
    finally:
        clip.close()
    if optics is None:
        return None
    lens, mount = optics.lens, optics.mounting
    apart_s = float(np.median(np.diff(frames_ns))) / NS_PER_S if len(frames_ns) > 1 else 0.1
    parameters = {
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "hfov_deg": math.degrees(2.0 * math.atan(0.5 * lens.width_px / lens.fx_px)),
        "rate_hz": 1.0 / apart_s,
        **{field.name: getattr(mount, field.name) for field in fields(mount)},
    }
    return parse_model(Camera, parameters, f"{bag.path}: camera")


def scenes(recorded: DrawableRecording) -> Iterator[tuple[int, Scene]]:
    """Yield the stamp and the scene of each frame with a state of the VUT, in order, each once."""
    if TICK in recorded.bag.topics:
        return _of_world(recorded)
    return _of_reports(recorded)


def _of_world(recorded: DrawableRecording) -> Iterator[tuple[int, Scene]]:
    """Yield the scenes of a simulated world, step by step, as its camera saw them."""
    run = recorded.facts.run
    if run is None:
        raise InputError(
            "has a simulated world and no run",
            file=recorded.bag.path,
            field=TICK,
            remedy="give a recording of `ssp run`, which attaches its run",
        )
    camera, pending_ns = Redrawing(run), set(recorded.frames_ns)
    for message in recorded.bag.messages([TICK]):
        try:
            tick = decode_tick(message.data)
        except ValueError as error:
            raise InputError(
                f"has an invalid message: {error}",
                file=recorded.bag.path,
                field=TICK,
                remedy="record the session again",
            ) from error
        scene = camera.see(tick.step, tick.stamp_ns, tick.objects)
        if scene is not None and tick.stamp_ns in pending_ns:
            pending_ns.remove(tick.stamp_ns)
            yield tick.stamp_ns, scene


def _of_reports(recorded: DrawableRecording) -> Iterator[tuple[int, Scene]]:
    """Yield the scenes of the states that were reported, each extrapolated to the frame's stamp."""
    people, road = recorded.people, recorded.road
    ids = [people.vut, *people.targets]
    states_by_id = object_states(recorded.bag, ids)
    rows = {
        name: _Reports([s for s in states if s.is_finite]) for name, states in states_by_id.items()
    }
    odometer, indicators = Odometer(), Indicators(road)
    for stamp_ns in recorded.frames_ns:
        estimates = [rows[name].at(stamp_ns) for name in sorted(rows)]
        states = tuple(state for state in estimates if state is not None)
        vut = next((state for state in states if state.object_id == people.vut), None)
        if vut is None:
            continue
        odometer.update(states)
        blinking = indicators.update(states, stamp_ns)
        yield stamp_ns, Scene(road, vut, states, odometer.snapshot(), blinking)


class _Reports:
    """The reports of one object by time."""

    def __init__(self, states: Sequence[ObjectState]) -> None:
        by_stamp = {state.stamp_ns: state for state in states}
        self._stamps_ns = sorted(by_stamp)
        self._states = [by_stamp[stamp_ns] for stamp_ns in self._stamps_ns]

    def at(self, stamp_ns: int) -> ObjectState | None:
        """Return the newest report, carried on; None: there is none, or it is too old."""
        index = bisect_right(self._stamps_ns, stamp_ns) - 1
        if index < 0 or stamp_ns - self._stamps_ns[index] > _STATE_AGE_NS:
            return None
        return self._states[index].extrapolated(stamp_ns)
