"""The recorded states of everybody in a recording of any recorder (METHOD 4.3).

A simulated session holds the world's own states; a live session, another's bag and a video with a
table of states hold what VUT and object targets reported. Both become one series that everything
else measures.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.cdr.messages import object_state, peek_stamp_ns, stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.files.reading import Model, parse_mapping, parse_model
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed, Series, StateSeries
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute
from ssp_core.vocabulary import ControlState
from ssp_eval.data.provenance import Provenance

WORLD = "the world"
# Another participant's state this old isn't carried on to the VUT's stamp.
STATE_AGE_S = 0.3
_TICK = absolute(WORLD_TICK)


@dataclass(frozen=True)
class Sighting:
    """One recorded state of one object.

    Args:
        t_s: clip time.
        source: id whose topic it came on, or WORLD.
        object_id: that it names.
        object_class: word.
        x_m: map.
        y_m: map.
        speed_mps: along its heading.
        sequence: of the source; 0: none.
    """

    t_s: float
    source: str
    object_id: str
    object_class: str
    x_m: float
    y_m: float
    speed_mps: float
    sequence: int = 0


@dataclass(frozen=True)
class RecordedStates:
    """The states of a recording.

    Args:
        series: (clip time in s, states by id), times rising; empty where there are none.
        source: where they come from, for people.
        sightings: every recorded state from the start on, for identities.
        tracking_m: per object the largest longitudinal and lateral tracking error that it reported.
    """

    series: Series
    source: str
    sightings: Sequence[Sighting] = ()
    tracking_m: Mapping[str, tuple[float, float]] = field(default_factory=dict)


NO_STATES = RecordedStates((), "no states")


def clip_zero_ns(provenance: Provenance, frames_ns: Sequence[int]) -> int | None:
    """Return the stamp of clip time 0: a session's start, else the first frame; None: neither.

    Args:
        provenance: of the recording.
        frames_ns: stamps of its frames, rising.
    """
    if provenance.run is not None:
        return provenance.session_start_ns
    return frames_ns[0] if frames_ns else None


def frame_times(bag: BagReader, provenance: Provenance) -> tuple[tuple[float, ...], int]:
    """Clip times of a recording's frames, rising, and the stamp that is clip time 0.

    Args:
        bag: open.
        provenance: of it.

    Raises:
        InputError: it has no frames, or is of a session that never ran.
    """
    topic = absolute(CAMERA_IMAGE)
    stamps_ns = sorted(peek_stamp_ns(message.data) for message in bag.messages([topic]))
    if not stamps_ns:
        raise InputError(
            "has no camera frames to look at",
            file=bag.path,
            field=topic,
            remedy="give a recording with camera frames",
        )
    zero_ns = clip_zero_ns(provenance, stamps_ns)
    if zero_ns is None:
        raise InputError(
            "holds a session that never reached RUNNING, so that it has no clip time",
            file=bag.path,
            remedy="run the task again",
        )
    return tuple(ns_to_seconds(stamp - zero_ns) for stamp in stamps_ns), zero_ns


def read_states(bag: BagReader, provenance: Provenance, zero_ns: int | None) -> RecordedStates:
    """Return the states of VUT, object targets and traffic from clip time 0 on.

    Args:
        bag: open.
        provenance: of it.
        zero_ns: see clip_zero_ns; None: no states.

    Raises:
        InputError: a message is damaged.
    """
    who = provenance.participants
    if who is None or zero_ns is None:
        return NO_STATES
    is_session = provenance.run is not None
    sightings = Packed(Sighting)
    series: Series = _world_states(bag, zero_ns, sightings)
    source = f"ground truth ({WORLD_TICK})"
    states_by_id = object_states(bag, who.ids)
    reported: dict[str, _Reported] = {}
    tracking_m: dict[str, tuple[float, float]] = {}
    for name in list(states_by_id):
        times_s, states = _reported(states_by_id.pop(name), zero_ns, is_session)
        for t_s, state in zip(times_s, states, strict=True):
            sightings.append(_sighting(t_s, name, state, state.sequence))
            if state.reference_id:
                before = tracking_m.get(name, (0.0, 0.0))
                errors = abs(state.error_longitudinal_m), abs(state.error_lateral_m)
                tracking_m[name] = max(before[0], errors[0]), max(before[1], errors[1])
        # The world's states are the better ones: of a long recording two copies are too many.
        if not series:
            reported[name] = times_s, states
    if not series:
        series = _joined(reported, who.vut)
        source = "states that VUT and object targets reported"
        if provenance.imported is not None and provenance.imported.states is not None:
            source = f"states of {provenance.imported.states.name}"
    return RecordedStates(series, source if series else NO_STATES.source, sightings, tracking_m)


def attached(bag: BagReader, name: str, model: type[Model]) -> Model | None:
    """Read the attachment of a bag by its name; None: there is none.

    Raises:
        InputError: it isn't valid.
    """
    data = bag.attachment(name)
    if data is None:
        return None
    place = f"{bag.path}:{name}"
    return parse_model(model, parse_mapping(data, place), place)


def _world_states(bag: BagReader, zero_ns: int, sightings: Packed[Sighting]) -> StateSeries:
    """Return the world's states; each is added to the sightings."""
    series = StateSeries()
    for message in bag.messages([_TICK]):
        tick = bag.decode(message)
        t_s = ns_to_seconds(stamp_ns(tick.header.stamp) - zero_ns)
        if tick.running and t_s >= 0.0:
            objects = [state for o in tick.objects if (state := object_state(o)).is_finite]
            series.append(t_s, objects)
            for state in objects:
                sightings.append(_sighting(t_s, WORLD, state, 0))
    return series


# Clip times and states of an object, in the order in which they came.
_Reported = tuple[Sequence[float], Packed[ObjectState]]


def _reported(states: Packed[ObjectState], zero_ns: int, is_session: bool) -> _Reported:
    """Return an object's own states with their clip times, as they came.

    An object that names its control states is followed until it is switched off; one that never
    does, as a vehicle without such states, says OFF all the time and means nothing by it.
    """
    names_states = any(state.control_state is not ControlState.OFF for state in states)
    times_s, own_states = array("d"), Packed(ObjectState)
    for state in states:
        t_s = ns_to_seconds(state.stamp_ns - zero_ns)
        # Before a session's start its states repeat.
        begun = t_s > 0.0 if is_session else t_s >= 0.0
        is_off = names_states and state.control_state is ControlState.OFF
        if begun and not is_off and state.is_finite:
            times_s.append(t_s)
            own_states.append(state)
    return times_s, own_states


def _sighting(t_s: float, source: str, state: ObjectState, sequence: int) -> Sighting:
    return Sighting(
        t_s,
        source,
        state.object_id,
        state.object_class.word,
        state.x_m,
        state.y_m,
        state.speed_mps,
        sequence,
    )


def _joined(reported: Mapping[str, _Reported], vut_id: str) -> StateSeries:
    """Return states of all objects at the stamps of the VUT's, the others extrapolated to them."""
    series = StateSeries()
    if vut_id not in reported:
        return series
    order = {
        name: sorted(
            (i for i, state in enumerate(states) if state.object_id == name),
            key=times_s.__getitem__,
        )
        for name, (times_s, states) in reported.items()
    }
    times = {name: array("d", (reported[name][0][i] for i in order[name])) for name in order}
    last_s = -math.inf
    for k, t_s in enumerate(times[vut_id]):
        if t_s <= last_s:
            continue
        last_s, vut = t_s, reported[vut_id][1][order[vut_id][k]]
        now = [vut]
        for name, (_, states) in reported.items():
            i = bisect_right(times[name], t_s) - 1
            if name != vut_id and i >= 0 and t_s - times[name][i] <= STATE_AGE_S:
                now.append(states[order[name][i]].extrapolated(vut.stamp_ns))
        series.append(t_s, now)
    return series
