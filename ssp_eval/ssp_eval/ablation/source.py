"""The source of an event as an arm receives it: tracks, or relations between objects alone.

No part of K* enters but who takes part, as what class, and which of them is the VUT. A test hands
over an event whose every other field raises.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.motion.state_series import Series, between
from ssp_core.names import VUT_ID
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.recordings.event import source_times
from ssp_eval.recordings.source_clip import board_of
from ssp_ot_controller.camera.clip import GENERATOR
from ssp_scenario_manager.event_spec.model import Event

_SEED = re.compile(r"\S+ seed (\d+)(?:, lanes \d\+\d)?")


@dataclass(frozen=True)
class Source:
    """The states of an event's source, and the road that it shows.

    Args:
        series: (clip time in s, states by id), times rising.
        road: of the source's own place, map frame of the states.
        origin: what it was read from, for people.
    """

    series: Series
    road: Road
    origin: str


# Slower than this a body stands, m/s.
STANDS_MPS = 0.2


@dataclass(frozen=True)
class Cast:
    """The participants of an event by id, with their classes.

    Args:
        vut_id: of the VUT.
        classes: of all, the VUT too.
    """

    vut_id: str
    classes: Mapping[str, ObjectClass]


@dataclass(frozen=True)
class Track:
    """An object's observed places over time, frame of the source; arrays of shape (n,)."""

    object_id: str
    object_class: ObjectClass
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray


@dataclass(frozen=True)
class Tracks:
    """The observed tracks of a source, all at the same times.

    Args:
        times_s: of the clip, from 0 on, shape (n,).
        vut: of the vehicle under test.
        others: of the object targets, by id.
    """

    times_s: FloatArray
    vut: Track
    others: tuple[Track, ...]


@dataclass(frozen=True)
class Course:
    """An object's course as the VUT sees it; arrays of shape (n,).

    Args:
        ahead_m: of the VUT's reference point, along its heading.
        left_m: across it.
        heading_rad: relative to the VUT's.
        speed_mps: the object's own.
    """

    object_id: str
    object_class: ObjectClass
    ahead_m: FloatArray
    left_m: FloatArray
    heading_rad: FloatArray
    speed_mps: FloatArray


@dataclass(frozen=True)
class Relations:
    """The classes, relative positions and speeds of a source's objects, without a map frame.

    Args:
        times_s: of the clip, from 0 on, shape (n,); no phase is named.
        vut_class: of the vehicle under test.
        vut_speed_mps: shape (n,).
        courses: of the object targets, by id.
    """

    times_s: FloatArray
    vut_class: ObjectClass
    vut_speed_mps: FloatArray
    courses: tuple[Course, ...]


def cast_of(event: Event) -> Cast:
    """Return who takes part; nothing else of the event is read."""
    participants = event.participants
    vut = next(name for name, one in participants.items() if one.role == "VUT")
    return Cast(
        vut, {name: ObjectClass.from_word(one.class_) for name, one in participants.items()}
    )


def read_source(event: Event, recording: Path | None = None) -> Source:
    """Return the states of an event's source.

    Args:
        event: whose clip the project's generator drew, where no recording is given.
        recording: of the source, with states and a road; None: the generator's ground truth.

    Raises:
        InputError: there are no states, or no road is bound to them.
    """
    if recording is not None:
        return _recorded(event, recording)
    original = _SEED.fullmatch(event.source.original or "")
    if event.source.generator != GENERATOR or original is None:
        raise InputError(
            "wasn't drawn by the project's clip generator, so that its tracks aren't known",
            file=event.name,
            field="source.original",
            value=event.source.original,
            remedy="name a recording of the source that has states and a road with --source",
        )
    board = board_of(event, int(original[1]))
    series = [(t_s, {s.object_id: s for s in board.states(t_s)}) for t_s in board.times()]
    return Source(series, board.road, f"ground truth of {GENERATOR} {event.source.original}")


def _recorded(event: Event, path: Path) -> Source:
    recording = read_recording(path)
    road, at = recording.road, source_times(event)
    if road is None or not recording.series:
        raise InputError(
            "has no states, or no road is bound to it",
            file=path,
            remedy="import it with a table of states and --site",
        )
    first_s = at["start"].mid if "start" in at else 0.0
    last_s = at["end"].mid if "end" in at else recording.series[-1][0]
    part = between(recording.series, first_s, last_s)
    vut = part[0][1].get(VUT_ID) if part else None
    if vut is not None and vut.speed_mps < STANDS_MPS:
        raise InputError(
            f"shows the VUT at {vut.speed_mps:.2f} m/s at its start, from which no arm can begin",
            file=path,
            field="--source",
            remedy="cut it so that it begins while the VUT drives (ssp bag cut)",
        )
    return Source([(t - first_s, states) for t, states in part], road.road, recording.source)


def tracks_of(source: Source, cast: Cast) -> Tracks:
    """Return what direct compilation is given: classes and observed tracks.

    Raises:
        InputError: a participant isn't there all the time.
    """
    times, tracks = _tracks(source.series, cast)
    others = (tracks[name] for name in sorted(tracks) if name != cast.vut_id)
    return Tracks(times, tracks[cast.vut_id], tuple(others))


def relations_of(source: Source, cast: Cast) -> Relations:
    """Return what compilation by relations is given: classes, relative positions, and speeds.

    Raises:
        InputError: a participant isn't there all the time.
    """
    times, tracks = _tracks(source.series, cast)
    vut = tracks[cast.vut_id]
    cos, sin = np.cos(vut.yaw_rad), np.sin(vut.yaw_rad)
    courses = []
    for name in sorted(tracks):
        if name == cast.vut_id:
            continue
        one = tracks[name]
        dx, dy = one.x_m - vut.x_m, one.y_m - vut.y_m
        courses.append(
            Course(
                name,
                one.object_class,
                cos * dx + sin * dy,
                cos * dy - sin * dx,
                one.yaw_rad - vut.yaw_rad,
                one.speed_mps,
            )
        )
    return Relations(times, vut.object_class, vut.speed_mps, tuple(courses))


def _tracks(series: Series, cast: Cast) -> tuple[FloatArray, dict[str, Track]]:
    missing = [name for name in cast.classes if any(name not in now for _, now in series)]
    if missing or len(series) < 2:
        raise InputError(
            f"doesn't show {', '.join(missing) or 'two instants'} all the time",
            field="--source",
            remedy="name a recording that holds the whole clip of K*",
        )
    times = np.array([t_s for t_s, _ in series])
    return times - times[0], {
        name: _track(name, object_class, series) for name, object_class in cast.classes.items()
    }


def _track(name: str, object_class: ObjectClass, series: Series) -> Track:
    states: Sequence[tuple[float, ...]] = [
        (one.x_m, one.y_m, one.yaw_rad, one.speed_mps) for one in (now[name] for _, now in series)
    ]
    x, y, yaw, speed = np.array(states).T
    return Track(name, object_class, x, y, np.unwrap(yaw), speed)
