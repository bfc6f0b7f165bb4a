"""q(d, k) and the phases of a recording, measured from its states alone (METHOD 1 and 4).

Nothing of the specification goes in but its thresholds and what it makes observable: who conflicts
with whom, how, and in which order, is found out here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ssp_core.geometry import box_distance, wrap_angle
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import comes_against, encounter
from ssp_core.motion.event import (
    TOLERANCE_S,
    Instant,
    RecordedEvent,
    find_event,
    instants_of,
)
from ssp_core.motion.intrusion import Intrusion, first_intrusions
from ssp_core.motion.passing import Passing, Zone, passing_of
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed, Series, states_of
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import MOTIONS, PhaseWord
from ssp_eval.audit.evidence.further import ScriptEvidence, script_evidence
from ssp_eval.audit.evidence.leaving import Leaving, leaving_of
from ssp_eval.audit.evidence.paths import Lanes, Spot
from ssp_eval.data.audit import CONFLICT, MOTION, ORDER, ROLES, TOPOLOGY, Property
from ssp_eval.recordings.event import LOCATED_S, EventRules
from ssp_eval.recordings.geometry import motion_word
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD

# Of the OT of a VUT's turn, as the compiler places it.
COMES_OPPOSITE = "the opposite way"


@dataclass(frozen=True)
class RoadFacts:
    """The road that is bound to a recording, with what its lanes don't say.

    Args:
        words: road type and boundaries, as far as the site or the map says.
    """

    road: Road
    words: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Scene:
    """Recorded states, and what is needed to read them.

    Args:
        series: (clip time in s, states by id), times rising, from the clip's start to its end.
        road: that they drive on; None: none is bound, and there is no topology.
        further_ids: targets that K* has beside the initiator, and that cause no conflict.
        begin: states by id where the session begins; None: the clip's first ones count.
        leaving_id: occluder that leaves the VUT's lane; None: K* has none.
        holding_id: initiator that does nothing; None: K* has one that acts.
    """

    series: Series
    vut_id: str
    target_ids: tuple[str, ...]
    road: RoadFacts | None
    start_s: float
    end_s: float
    rules: EventRules
    further_ids: tuple[str, ...] = ()
    begin: Mapping[str, ObjectState] | None = None
    leaving_id: str | None = None
    holding_id: str | None = None


@dataclass(frozen=True)
class Phases:
    """Starts of the phases in clip time, s; None where one can't be located.

    The approach starts with the clip.
    """

    start_s: float
    end_s: float
    trigger_s: float | None
    conflict_s: float | None
    resolution_s: float | None

    @property
    def has_approach(self) -> bool:
        """METHOD 4.1: at least 0.5 s of the approach lies in the clip."""
        return self.trigger_s is None or self.trigger_s - self.start_s >= LOCATED_S - TOLERANCE_S

    @property
    def has_resolution(self) -> bool:
        """METHOD 4.1: at least 0.5 s of the resolution lies in the clip."""
        return (
            self.resolution_s is None or self.end_s - self.resolution_s >= LOCATED_S - TOLERANCE_S
        )

    @property
    def critical_s(self) -> tuple[float, float] | None:
        """Return the span from the trigger to the resolution, or else to the clip's end."""
        if self.trigger_s is None:
            return None
        return self.trigger_s, self.end_s if self.resolution_s is None else self.resolution_s


@dataclass(frozen=True)
class Measurements:
    """The measurements from the states.

    Args:
        properties: q(d, k) per field; without a road there is no topology.
        initiator: whose manoeuvre is the event, None: there is none.
        zone: outline of the conflict zone in map, None: there is none.
        zone_until_s: clip time at which the VUT reaches it, None: it never does.
        first_arrival_s: clip time of the first arrival at the zone, None: there is none.
        facts: quantities with their units in the name; None: it doesn't exist.
        intrusions: conflicts with further participants before that of the event.
        courses: of the further participants; empty without a trigger.
        leaving: lane change of the occluder that leaves; None: K* has none, it isn't there, or no
            road is bound.
        holding: course of the initiator that does nothing; None: K* has none, or there is no
            trigger.
    """

    properties: Mapping[str, Property]
    phases: Phases
    initiator: str | None
    affected: str | None
    zone: tuple[tuple[float, float], ...] | None
    zone_until_s: float | None
    first_arrival_s: float | None
    facts: Mapping[str, float | None]
    notes: tuple[str, ...]
    intrusions: tuple[Intrusion, ...] = ()
    courses: tuple[ScriptEvidence, ...] = ()
    leaving: Leaving | None = None
    holding: ScriptEvidence | None = None


@dataclass(frozen=True)
class _Pair:
    """Somebody's event as seen from somebody else."""

    observer: str
    other: str
    samples: Sequence[Instant]
    corridor: Corridor
    event: RecordedEvent | None


def measure(scene: Scene) -> Measurements:
    """Measure a recording.

    Raises:
        ValueError: there is no state of the VUT, or no OT is ever there together with it.
    """
    vut = states_of(scene.series, scene.vut_id)
    if not vut:
        raise ValueError(f"there are no states of {scene.vut_id}")
    pair = _critical_pair(scene, vut)
    event = pair.event
    phases = Phases(
        scene.start_s,
        scene.end_s,
        None if event is None else event.trigger_s,
        None if event is None else event.conflict_s,
        None if event is None else event.resolution_s,
    )
    meeting = passing_of(pair.samples, pair.corridor, event)
    target_id = pair.other if pair.observer == scene.vut_id else pair.observer
    own = Corridor.of(vut)
    lanes = None if scene.road is None else Lanes.of(scene.road.road, vut)
    swapped = pair.observer != scene.vut_id
    properties = {
        ROLES: _roles(scene, lanes, pair),
        MOTION: _dominant_motion(scene, own, target_id, phases),
        CONFLICT: Property(
            {"paths": (meeting.relation,)},
            f"how the path of {pair.other} meets the corridor of {pair.observer}",
        ),
        ORDER: _order(pair, meeting),
    }
    zone = None
    if meeting.zone is not None:
        zone = _outline(pair.corridor, meeting.zone)
    if scene.road is not None and lanes is not None:
        properties[TOPOLOGY] = _topology(scene, lanes, zone, vut, target_id)
    holding = () if scene.holding_id is None else (scene.holding_id,)
    until_s = meeting.other_arrival_s if swapped else meeting.own_arrival_s
    return Measurements(
        properties,
        phases,
        None if event is None else pair.other,
        None if event is None else pair.observer,
        zone,
        until_s,
        _first_arrival(meeting),
        _facts(scene, own, target_id, phases, meeting),
        _notes(pair, meeting),
        _intrusions(scene, own, pair),
        _script_evidence(scene, lanes, phases, scene.further_ids),
        _leaving(scene, lanes, target_id),
        next(iter(_script_evidence(scene, lanes, phases, holding)), None),
    )


def _leaving(scene: Scene, lanes: Lanes | None, target_id: str) -> Leaving | None:
    """Return the lane change of the occluder that leaves."""
    own = None if lanes is None else _first_spot(scene, lanes, scene.vut_id)
    if scene.leaving_id is None or lanes is None or own is None or own.lane is None:
        return None
    ids = scene.vut_id, target_id
    return leaving_of(scene.leaving_id, scene.series, lanes, ids, own.lane)


def _script_evidence(
    scene: Scene, lanes: Lanes | None, phases: Phases, ids: Sequence[str]
) -> tuple[ScriptEvidence, ...]:
    """Return the courses of some participants from the trigger to the resolution."""
    span = phases.critical_s
    if span is None or not ids:
        return ()
    start_s, end_s = span
    conflict_s = end_s if phases.conflict_s is None else phases.conflict_s
    by_phase: dict[PhaseWord, Series] = {
        "trigger": [one for one in scene.series if start_s <= one[0] < conflict_s],
        "conflict": [one for one in scene.series if conflict_s <= one[0] <= end_s],
    }
    own = None if lanes is None else _first_spot(scene, lanes, scene.vut_id)
    courses = []
    for name in ids:
        begin, both = scene.begin, {scene.vut_id, name}
        if begin is None:
            begin = next((now for _, now in scene.series if both <= set(now)), {})
        start = begin.get(scene.vut_id), begin.get(name)
        courses.append(
            script_evidence(name, by_phase, lanes, None if own is None else own.lane, start)
        )
    return tuple(courses)


def _intrusions(scene: Scene, corridor: Corridor, pair: _Pair) -> tuple[Intrusion, ...]:
    """Return the conflicts with further participants before the event's."""
    others = [name for name in scene.further_ids if name not in (pair.other, pair.observer)]
    return tuple(
        first_intrusions(
            (instants_of(scene.series, scene.vut_id, name) for name in others),
            corridor.path,
            scene.rules.thresholds,
            None if pair.event is None else pair.event.conflict_s,
        )
    )


def _critical_pair(scene: Scene, vut: Sequence[ObjectState]) -> _Pair:
    """Return the event of METHOD 1: the OT's whose conflict comes first, as the VUT sees it.

    Only where no OT has a conflict with the VUT the question is turned round: does the VUT do to an
    OT what the OT should have done to it?
    """
    pairs, turned = [], []
    corridor = Corridor.of(vut)
    for target_id in scene.target_ids:
        samples = instants_of(scene.series, scene.vut_id, target_id)
        if not samples:
            continue
        pairs.append(_pair(scene, scene.vut_id, target_id, samples, corridor))
    if not pairs:
        raise ValueError(f"none of {', '.join(scene.target_ids)} is there with {scene.vut_id}")
    best = min(pairs, key=_urgency)
    if best.event is not None and best.event.conflict_s is not None:
        return best
    for target_id in scene.target_ids:
        samples = instants_of(scene.series, target_id, scene.vut_id)
        if any(s.vut.speed_mps > 0.0 for s in samples):
            path = Corridor.of(Packed(ObjectState, (s.vut for s in samples)))
            pair = _pair(scene, target_id, scene.vut_id, samples, path)
            # Of two paths that cross, neither is the one that the other crosses.
            if passing_of(samples, path, pair.event).relation in ("merge", "following"):
                turned.append(pair)
    return min([*pairs, *turned], key=_urgency)


def _urgency(pair: _Pair) -> tuple[float, float]:
    """Return events with a conflict first, then events, then the rest; the earlier the first."""
    if pair.event is None:
        return math.inf, math.inf
    conflict_s = pair.event.conflict_s
    return (math.inf if conflict_s is None else conflict_s), pair.event.trigger_s


def _pair(
    scene: Scene, observer: str, other: str, samples: Sequence[Instant], corridor: Corridor
) -> _Pair:
    event = find_event(
        samples,
        corridor.path,
        scene.rules.thresholds,
        scene.rules.observable or "lateral",
        harmless=True,
        for_good_s=scene.rules.for_good_s,
    )
    return _Pair(observer, other, samples, corridor, event)


def _topology(
    scene: Scene,
    lanes: Lanes,
    zone: Sequence[tuple[float, float]] | None,
    vut: Sequence[ObjectState],
    target_id: str,
) -> Property:
    spots = [spot for state in vut if (spot := lanes.spot(state)) is not None]
    if not spots:
        return Property(None, "the VUT is nowhere on the road")
    vut_lane = _most([spot.lane for spot in spots])
    other = _first_spot(scene, lanes, target_id)
    adjacency = "unknown"
    if other is not None:
        adjacency = _adjacency(other.lane, vut_lane)
    how = "lanes of the road under the VUT's path; its lane is the one that it is in longest"
    crossed = None if zone is None else np.array(zone)
    stations = [spot.s_m for spot in spots]
    words = {} if scene.road is None else scene.road.words
    return Property(
        {
            "lanes_same_direction": (str(lanes.same_direction),),
            "lanes_opposite": (str(lanes.opposite),),
            "segment": (lanes.segment(min(stations), max(stations), crossed),),
            "vut_lane": lanes.lane_words(vut_lane),
            "adjacency": (adjacency,),
            **{name: (word,) for name, word in words.items()},
        },
        how,
    )


def _most(lanes: Sequence[int | None]) -> int | None:
    """Return the most frequent value; of equal ones the first."""
    return max(dict.fromkeys(lanes), key=lanes.count)


def _adjacency(origin: int | None, target: int | None) -> str:
    """Describe how the lane of the other's origin lies to the VUT's."""
    if origin is None or target is None:
        return "beside the lanes"
    if origin == target:
        return "same lane"
    return "adjacent lanes" if abs(origin - target) == 1 else "lanes apart"


def _first_spot(scene: Scene, lanes: Lanes, object_id: str) -> Spot | None:
    first = next((states[object_id] for _, states in scene.series if object_id in states), None)
    return None if first is None else lanes.spot(first)


def _roles(scene: Scene, lanes: Lanes | None, pair: _Pair) -> Property:
    own = None if lanes is None else _first_spot(scene, lanes, scene.vut_id)
    own_lane = None if own is None else own.lane
    words: dict[str, tuple[str, ...]] = {}
    for object_id in (scene.vut_id, *scene.target_ids):
        classes = {
            states[object_id].object_class.word for _, states in scene.series if object_id in states
        }
        role = "VUT" if object_id == scene.vut_id else "OT"
        words[object_id] = (f"{role}, {' then '.join(sorted(classes)) or 'never there'}",)
        if role == "VUT" and scene.rules.vut_turn is not None:
            words[object_id] = (f"{words[object_id][0]}, {_intent(scene)}",)
        spot = None if lanes is None else _first_spot(scene, lanes, object_id)
        if object_id != scene.vut_id and spot is not None and lanes is not None:
            words[f"{object_id} starts in"] = (lanes.place_word(spot, own_lane),)
    if scene.rules.vut_turn is not None:
        target_id = pair.other if pair.observer == scene.vut_id else pair.observer
        words[comes_part(target_id)] = (_comes(scene, target_id),)
    # Without an event nobody has the wrong part in it.
    everybody = (scene.vut_id, *scene.target_ids)
    words["initiator"] = everybody if pair.event is None else (pair.other,)
    words["affected"] = everybody if pair.event is None else (pair.observer,)
    return Property(words, "recorded classes, lanes at the clip's start, and whose event it is")


def comes_part(object_id: str) -> str:
    """Name the part of the roles that says from where the OT of a VUT's turn comes."""
    return f"{object_id} comes"


def _comes(scene: Scene, object_id: str) -> str:
    """Return from where somebody comes, by its and the VUT's headings when both are first there."""
    first = instants_of(scene.series, scene.vut_id, object_id)[0]
    if comes_against(first.vut.yaw_rad, first.other.yaw_rad):
        return COMES_OPPOSITE
    turned_deg = math.degrees(wrap_angle(first.other.yaw_rad - first.vut.yaw_rad))
    return f"at {turned_deg:+.0f} deg to the VUT"


def _intent(scene: Scene) -> str:
    """Return the turn that the VUT drove, by its headings first and last; ``keep_lane``: none."""
    vut = states_of(scene.series, scene.vut_id)
    turned_rad = wrap_angle(vut[-1].yaw_rad - vut[0].yaw_rad)
    if abs(turned_rad) < STRAIGHT_ON_RAD:
        return "keep_lane"
    return "turn_left" if turned_rad > 0.0 else "turn_right"


def _dominant_motion(scene: Scene, corridor: Corridor, target_id: str, phases: Phases) -> Property:
    span = phases.critical_s
    if span is None:
        return Property(None, "there is no trigger that it could be measured from")
    durations_s: dict[str, float] = dict.fromkeys(MOTIONS, 0.0)
    samples = instants_of(scene.series, scene.vut_id, target_id)
    for sample, following in pairwise(samples):
        if span[0] <= sample.t_s < span[1]:
            word = motion_word(corridor, sample.vut, sample.other)
            durations_s[word] += following.t_s - sample.t_s
    word = max(MOTIONS, key=lambda motion: durations_s[motion])
    if durations_s[word] <= 0.0:
        return Property(None, "the trigger comes with the last state")
    shares = ", ".join(
        f"{w} {t:.2f} s" for w, t in sorted(durations_s.items(), key=lambda x: -x[1]) if t > 0.0
    )
    return Property({"motion": (word,)}, f"of {target_id} from {span[0]:.2f} s on: {shares}")


def _order(pair: _Pair, meeting: Passing) -> Property:
    first = meeting.other_first
    if first is None:
        return Property(None, "the paths have no conflict zone")
    pair_ids = (pair.other, pair.observer) if first else (pair.observer, pair.other)
    other, own = meeting.other_arrival_s, meeting.own_arrival_s
    there = "was in it from the beginning" if other == -math.inf else f"at {other:.2f} s"
    here = "never" if own is None else f"at {own:.2f} s"
    how = f"arrival at the conflict zone: {pair.other} {there}, {pair.observer} {here}"
    return Property({"order": (" before ".join(pair_ids),)}, how)


def _first_arrival(meeting: Passing) -> float | None:
    arrivals = (meeting.other_arrival_s, meeting.own_arrival_s)
    return min((t_s for t_s in arrivals if t_s is not None), default=None)


def _outline(corridor: Corridor, zone: Zone) -> tuple[tuple[float, float], ...]:
    """Return the zone's corners and edges in map, counter-clockwise, every 2 m along a bend."""
    steps = max(1, math.ceil((zone.end_m - zone.start_m) / 2.0))
    stations = [zone.start_m + (zone.end_m - zone.start_m) * k / steps for k in range(steps + 1)]
    right = [corridor.path.pose(s, -corridor.half_width_m) for s in stations]
    left = [corridor.path.pose(s, corridor.half_width_m) for s in reversed(stations)]
    return tuple((p.x_m, p.y_m) for p in [*right, *left])


def _facts(
    scene: Scene, corridor: Corridor, target_id: str, phases: Phases, meeting: Passing
) -> dict[str, float | None]:
    samples = instants_of(scene.series, scene.vut_id, target_id)
    span = phases.critical_s
    meetings = [
        encounter(s.vut, s.other, corridor.path)
        for s in samples
        if span is not None and span[0] <= s.t_s <= span[1]
    ]
    ttc_s = min((m.ttc_s for m in meetings), default=math.inf)
    nearest_m = min(box_distance(s.vut.box, s.other.box) for s in samples)
    facts: dict[str, float | None] = {
        "time_gap_s": meeting.time_gap_s,
        "min_ttc_s": ttc_s if math.isfinite(ttc_s) else None,
        "min_distance_m": nearest_m,
        "trigger_gap_m": meetings[0].gap_m if meetings else None,
    }
    for name, t_s in (("trigger", phases.trigger_s), ("conflict", phases.conflict_s)):
        now = None if t_s is None else next((s for s in samples if s.t_s >= t_s), None)
        facts[f"vut_speed_at_{name}_mps"] = None if now is None else now.vut.speed_mps
        facts[f"ot_speed_at_{name}_mps"] = None if now is None else now.other.speed_mps
    return facts


def _notes(pair: _Pair, meeting: Passing) -> tuple[str, ...]:
    notes = []
    if meeting.other_first and meeting.own_arrival_s is None:
        notes.append(f"{pair.observer} never reaches the conflict zone; {pair.other} is the first")
    return tuple(notes)
