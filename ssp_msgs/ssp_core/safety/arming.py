"""The obstacles to connecting, arming and starting a session: facts, and their words for people.

``CHECKS`` is the list of everything that is asked. Whatever may end an armed session at the next
look stands in it; the silence of participants comes from the table of ssp_core.safety.liveness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import combinations, product

from ssp_core import names
from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import box_distance, wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.consistency import ConsistencyWatch
from ssp_core.safety.fence import box_excess_m
from ssp_core.safety.limits import LimitViolation
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.liveness import RECORDER_SIGN, SignOfLife, signs_of_life
from ssp_core.safety.object_rules import RulesCheck, untold
from ssp_core.safety.publishers import FORGOTTEN_S
from ssp_core.vocabulary import ControlState


class Gate(Enum):
    """A command that needs something."""

    CONNECT = "connect"
    ARM = "arm"
    START = "start"


# What an object must report before a command.
_CONTROL = {
    Gate.ARM: (ControlState.DISARMED, ControlState.ARMED),
    Gate.START: (ControlState.ARMED,),
}


# After a refusal objects are asked to arm again no sooner than this.
ARM_AGAIN_S = 1.0
# The transition of a session whose objects don't arm (SessionState.event).
ARM_FAILED = "arm_failed"
_REFUSED = " refused: "


def refusal_text(object_id: str, reason: str) -> str:
    """Say that an object refused to arm, as a session's transition gives it."""
    return f"{object_id}{_REFUSED}{reason}"


def refusal_of(text: str) -> dict[str, str]:
    """Read the refusal in a text of ``refusal_text``; empty for other texts."""
    object_id, refused, reason = text.partition(_REFUSED)
    return {object_id: reason} if refused else {}


class Need(Enum):
    """A need that isn't met, with its words; ``{detail}`` is text of its own."""

    VUT_STATE = "no state of the VUT arrives"
    OBJECT_STATE = "no state of {who} arrives"
    WORLD = "no tick of the simulated world arrives"
    ANSWERS = "the simulated world waits for {detail}: no answer to its first step"
    RECORDER = "the recorder is silent"
    CAMERA = "no camera frame arrives"
    REPLY = "clock offset and link delay of {who} are not measured: no answer to heartbeats"
    RECEIVER = "the VUT's GNSS/INS gives no state: {detail}"
    NOT_REFUSED = "{who} has just refused to arm: {detail}"
    BODY = "{who}: {detail}"
    ONE_MANAGER = "{measured:g} publishers too many, limit 0{detail}"
    RULES = "{detail}"
    RECORDER_READY = "the recorder is not ready: {detail}"
    RECORDER_LOSSLESS = "the recorder has lost {measured:g} messages, limit 0"
    CLOCK = "the clock of {who} is off by {measured:.3f} s, limit {limit:g} s"
    LINK = "the link to {who} takes {measured:.3f} s there and back, limit {limit:g} s"
    CONTROL = "{who} is {detail}"
    FINITE = "{who} has a state with a value that is no number"
    BODY_STATED = "{who} states {detail}"
    YOUNG = "the state of {who} is {measured:.2f} s old, limit {limit:g} s"
    NOT_AHEAD = "the state of {who} is stamped {measured:.3f} s ahead of time, limit {limit:g} s"
    LOCALISED = "the position of {who} is uncertain by {measured:.2f} m, limit {limit:g} m"
    AT_START = "{who} is {measured:.2f} m from its start, limit {limit:g} m"
    HEADING = "{who} is turned by {measured:+.2f} rad from its start's heading, limit {limit:g} rad"
    STANDING = "{who} moves at {measured:.2f} m/s, limit {limit:g} m/s"
    STAYING = "{who} says that it stands and went {measured:.2f} m{detail}, limit {limit:.2f} m"
    CONSISTENT = "the states of {who} contradict its places: {detail}"
    INSIDE = "{who} is outside the geofence by {measured:.2f} m, limit 0 m"
    TRIGGERS = (
        "states of {who} are {measured:.3f} s old when they come, limit for triggers "
        "{limit:g} s (limits.trigger_age_s)"
    )
    STATED = "the state of {who} passes a limit: {detail}"
    APART = "{who} is {measured:.2f} m from {detail}, limit {limit:g} m"


_OF_SIGN = {
    SafetyCode.VUT_SILENT: Need.VUT_STATE,
    SafetyCode.OBJECT_SILENT: Need.OBJECT_STATE,
    SafetyCode.WORLD_SILENT: Need.WORLD,
    SafetyCode.RECORDER: Need.RECORDER,
    SafetyCode.PARTICIPANT_LOST: Need.CAMERA,
    SafetyCode.REPLY_MISSING: Need.REPLY,
}
_OF_LINK = {SafetyCode.CLOCK_OFFSET: Need.CLOCK, SafetyCode.LINK_DELAY: Need.LINK}
_SILENCE = frozenset(_OF_SIGN.values())


@dataclass(frozen=True, slots=True)
class Obstacle:
    """One thing that keeps a session from a command.

    Args:
        who: object or node that it is about; empty for the session.
        measured: in the unit of the words; infinite for what was never heard.
        limit: that ``measured`` may be at most.
    """

    need: Need
    who: str = ""
    measured: float = math.nan
    limit: float = math.nan
    detail: str = ""

    @property
    def text(self) -> str:
        """The sentence for people."""
        text = self.need.value.format(
            who=self.who, measured=self.measured, limit=self.limit, detail=self.detail
        )
        if self.need not in _SILENCE:
            return text
        why = f": {self.detail}" if self.detail else ""
        if math.isinf(self.measured):
            return f"{text}{why}"
        none = "" if self.need in (Need.RECORDER, Need.REPLY) else ": none"
        return f"{text}{none} for {self.measured:.2f} s, limit {self.limit:g} s{why}"


@dataclass(frozen=True, slots=True)
class Facts:
    """The facts known beside the states.

    Args:
        ages_s: seconds on the steady clock since the last sign of life of a node or object, by its
            name; what isn't in it was never heard.
        links: by object; their ages are those of the answers to heartbeats.
        rules: by object, what it judges by, held against the run's.
        recorder_missing: what the recorder waits for (``recorder_lacks``).
        unanswered: nodes that the world of a lockstep run, which is heard, waits for before the VUT
            says anything.
        vut_refused: why no state is made of what the VUT's receiver says now; empty: one is, or it
            isn't stated.
        motion: what the VUT and the objects state, held against their places, by id.
        other_managers: how many publish what they shouldn't (ssp_core.safety.publishers).
        foreign: which, for people.
        bodies: by object, what its process knows of its body; where there is nothing to say, or it
            isn't stated, there is none.
        refusals: by object, of the last command to arm, while it is too soon for another.
        lasting: one of these refusals stays as long as the object's process runs.
    """

    ages_s: Mapping[str, float] = field(default_factory=dict)
    links: Mapping[str, LinkEstimate] = field(default_factory=dict)
    rules: Mapping[str, RulesCheck] = field(default_factory=dict)
    recorder_ready: bool = False
    recorder_missing: tuple[str, ...] = ()
    recorder_lost: int = 0
    unanswered: tuple[str, ...] = ()
    vut_refused: str = ""
    motion: Mapping[str, ConsistencyWatch] = field(default_factory=dict)
    other_managers: int = 0
    foreign: str = ""
    bodies: Mapping[str, BodyStatus] = field(default_factory=dict)
    refusals: Mapping[str, str] = field(default_factory=dict)
    lasting: bool = False

    @property
    def is_hopeless(self) -> bool:
        """No waiting lets every object be armed: an object's process must be started anew."""
        return self.lasting or any(body.lasting for body in self.bodies.values())

    def silence_s(self, who: str) -> float:
        """Return the seconds since a node or object was heard; infinite for what never was."""
        return self.ages_s.get(who, math.inf)

    @staticmethod
    def of_one_process(spec: RunSpec) -> Facts:
        """Make the facts of a session whose parts share one process.

        It has no links, one clock, and no other processes.
        """
        ids = [target.id for target in spec.targets]
        nodes = (names.SIL_WORLD, names.MONITOR, names.FRONT_CAMERA, names.VUT_ID)
        return Facts(
            ages_s=dict.fromkeys((*nodes, *ids), 0.0),
            links=dict.fromkeys(ids, LinkEstimate(0.0, 0.0, 0.0)),
            rules=dict.fromkeys(ids, RulesCheck()),
            recorder_ready=True,
        )


def recorder_lacks(
    missing: Sequence[str], failure: str, warnings: Sequence[str]
) -> tuple[str, ...]:
    """Say what a recorder that isn't ready lacks (RecorderStatus.msg).

    That is topics; without one it is the file or the disk, of which the first warning tells.
    """
    return tuple(missing) or ((failure,) if failure else tuple(warnings[:1]))


@dataclass(frozen=True, slots=True)
class Situation:
    """A session as a gate finds it.

    Args:
        vut: newest state; None before the first.
        targets: newest states by id.
        now_ns: session time.
        signs: the run's table of ssp_core.safety.liveness.
    """

    gate: Gate
    spec: RunSpec
    facts: Facts
    vut: ObjectState | None
    targets: Mapping[str, ObjectState]
    now_ns: int
    signs: tuple[SignOfLife, ...]

    @property
    def present(self) -> list[tuple[ParticipantSpec, ObjectState]]:
        """Participants of which a state is known, the VUT first.

        Of one whose heading isn't known at rest the start's counts, until its first metre.
        """
        states = {**self.targets, **({} if self.vut is None else {self.spec.vut.id: self.vut})}
        everyone = (self.spec.vut, *self.spec.targets)
        return [
            (one, self._with_start_heading(one, states[one.id]))
            for one in everyone
            if one.id in states
        ]

    def _with_start_heading(self, one: ParticipantSpec, state: ObjectState) -> ObjectState:
        """Return a state, turned as its start is where its heading isn't known at rest."""
        if one.id not in self.spec.limits.heading_by_course:
            return state
        return replace(state, yaw_rad=one.start.yaw_rad)

    def states_to_judge(self, one: ParticipantSpec, state: ObjectState) -> Sequence[ObjectState]:
        """Return a state, and beside it the one as stated, which an armed session is judged by."""
        stated = self.state_of(one.id)
        return (state,) if stated is None or stated is state else (state, stated)

    def state_of(self, object_id: str) -> ObjectState | None:
        """Return the newest state of the VUT or of an object."""
        own = object_id in (names.VUT_ID, self.spec.vut.id)
        return self.vut if own else self.targets.get(object_id)

    def age_s(self, state: ObjectState) -> float:
        """Return the age of a state by its stamp, s; below zero for a stamp ahead of time."""
        return ns_to_seconds(self.now_ns - state.stamp_ns)


def obstacles(
    gate: Gate,
    spec: RunSpec,
    facts: Facts,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
) -> list[Obstacle]:
    """Find everything that a command lacks, each with object, measured value and limit.

    Connecting needs a sign of life of the VUT and the objects. Arming and starting need one of
    everybody, and that everything is measured, recorded and in place; an object is DISARMED or
    ARMED for the one, ARMED for the other.
    """
    situation = Situation(gate, spec, facts, vut, targets, now_ns, signs_of_life(spec))
    checks = _OF_CONNECT if gate is Gate.CONNECT else CHECKS
    return [obstacle for check in checks for obstacle in check(situation)]


# -- each thing that is asked --------------------------------------------------------------------


def _states_arrive(at: Situation) -> Iterator[Obstacle]:
    for sign in at.signs:
        if sign.code not in (SafetyCode.VUT_SILENT, SafetyCode.OBJECT_SILENT) or sign.by_stamp:
            continue
        world_steps = names.SIL_WORLD in at.facts.ages_s
        if sign.who == names.VUT_ID and at.vut is None and world_steps and at.facts.unanswered:
            detail = " and ".join(at.facts.unanswered)
            yield Obstacle(Need.ANSWERS, names.SIL_WORLD, detail=detail)
            continue
        silence_s = math.inf if at.state_of(sign.who) is None else at.facts.silence_s(sign.who)
        body = at.facts.bodies.get(sign.who)
        yield from _silent(sign, silence_s, "" if body is None else "; ".join(body.no_state))


def _receiver_gives_states(at: Situation) -> Iterator[Obstacle]:
    if at.facts.vut_refused:
        yield Obstacle(Need.RECEIVER, at.spec.vut.id, detail=at.facts.vut_refused)


def _bodies_ready(at: Situation) -> Iterator[Obstacle]:
    """Find real bodies that aren't ready, as their processes see them.

    What keeps states away has been said.
    """
    for target in at.spec.targets:
        body = at.facts.bodies.get(target.id)
        for text in body.cannot_arm if body is not None else ():
            if body is None or text not in body.no_state:
                yield Obstacle(Need.BODY, target.id, detail=text)


def _not_refused(at: Situation) -> Iterator[Obstacle]:
    """Hold back a command that an object refused a moment ago, from it and from all others."""
    if at.gate is Gate.ARM:
        for who, text in at.facts.refusals.items():
            yield Obstacle(Need.NOT_REFUSED, who, detail=text)


def _one_manager(at: Situation) -> Iterator[Obstacle]:
    if at.facts.other_managers:
        gone = f"one whose process has ended is forgotten within {FORGOTTEN_S} s"
        who = f": {at.facts.foreign}; {gone}" if at.facts.foreign else ""
        yield Obstacle(Need.ONE_MANAGER, "", float(at.facts.other_managers), 0.0, who)


def _same_rules(at: Situation) -> Iterator[Obstacle]:
    """Find objects that judge less strictly than the run's file says, or in no known way."""
    for target in at.spec.targets:
        if problem := at.facts.rules.get(target.id, untold(target.id)).problem:
            yield Obstacle(Need.RULES, target.id, detail=problem)


def _nodes_live(at: Situation) -> Iterator[Obstacle]:
    """Find silence of world, recorder and camera; a recorder that is heard must also be ready."""
    for sign in at.signs:
        if sign.code not in (
            SafetyCode.WORLD_SILENT,
            SafetyCode.RECORDER,
            SafetyCode.PARTICIPANT_LOST,
        ):
            continue
        if sign == RECORDER_SIGN:
            yield from recorder_obstacles(at.facts)
        else:
            yield from _silent(sign, at.facts.silence_s(sign.who))


def recorder_obstacles(facts: Facts) -> Iterator[Obstacle]:
    """Find what the recorder lacks, which needs no run file to be said."""
    silent = list(_silent(RECORDER_SIGN, facts.silence_s(RECORDER_SIGN.who)))
    yield from silent
    if silent:
        return
    if not facts.recorder_ready:
        topics = ", ".join(facts.recorder_missing) or "its file is not open"
        yield Obstacle(Need.RECORDER_READY, names.MONITOR, detail=topics)
    elif facts.recorder_lost:
        yield Obstacle(Need.RECORDER_LOSSLESS, names.MONITOR, float(facts.recorder_lost), 0.0)


def _links_good(at: Situation) -> Iterator[Obstacle]:
    limits = at.spec.limits
    for sign in at.signs:
        if sign.code is not SafetyCode.REPLY_MISSING:
            continue
        link = at.facts.links.get(sign.who, LinkEstimate())
        silence_s = link.age_s
        if silence_s <= sign.arming_limit_s and not math.isfinite(link.delay_s):
            silence_s = math.inf
        silent = list(_silent(sign, silence_s))
        yield from silent
        if not silent:
            for passed in judge.link_violations(link.offset_s, link.delay_s, limits):
                yield from _limit_obstacle(_OF_LINK[passed.code], sign.who, passed)


def _stamps_good(at: Situation) -> Iterator[Obstacle]:
    """Find states that are too old by their stamps, or stamped ahead of time."""
    for sign in at.signs:
        state = at.state_of(sign.who) if sign.by_stamp else None
        if state is None:
            continue
        age_s = at.age_s(state)
        if not age_s <= sign.arming_limit_s:
            yield Obstacle(Need.YOUNG, sign.who, age_s, sign.arming_limit_s)
        if (ahead := judge.stamp_ahead(age_s, at.spec.limits)) is not None:
            yield Obstacle(Need.NOT_AHEAD, sign.who, -age_s, ahead.limit)


def _in_place(at: Situation) -> Iterator[Obstacle]:
    """Find what is wrong with control state, values, place and motion of each."""
    for participant, state in at.present:
        control_states = _CONTROL[at.gate]
        if participant is not at.spec.vut and state.control_state not in control_states:
            which = " or ".join(control.name for control in control_states)
            detail = f"{state.control_state.name}, not {which}"
            yield Obstacle(Need.CONTROL, participant.id, detail=detail)
        if not all(one.is_finite for one in at.states_to_judge(participant, state)):
            yield Obstacle(Need.FINITE, participant.id)
        else:
            yield from _at_its_start(at, participant, state)


def _at_its_start(
    at: Situation, participant: ParticipantSpec, state: ObjectState
) -> Iterator[Obstacle]:
    who, limits, start = participant.id, at.spec.limits, participant.start
    if stated := judge.other_body(state, participant.cls):
        yield Obstacle(Need.BODY_STATED, who, detail=stated)
    yield from _limit_obstacle(Need.LOCALISED, who, judge.localisation(state, limits))
    away_m = math.hypot(state.x_m - start.x_m, state.y_m - start.y_m)
    if not away_m <= limits.start_region_m:
        yield Obstacle(Need.AT_START, who, away_m, limits.start_region_m)
    turned_rad = wrap_angle(state.yaw_rad - start.yaw_rad)
    if not abs(turned_rad) <= limits.start_yaw_rad:
        yield Obstacle(Need.HEADING, who, turned_rad, limits.start_yaw_rad)
    watch = at.facts.motion.get(who)
    way_and_limit_m = None if watch is None else judge.net_way_m(watch)
    if not abs(state.speed_mps) <= judge.STANDSTILL_MPS:
        yield Obstacle(Need.STANDING, who, state.speed_mps, judge.STANDSTILL_MPS)
    elif way_and_limit_m is not None:
        yield Obstacle(Need.STAYING, who, *way_and_limit_m, f" in {judge.STOOD_S:g} s")
    if watch is not None and watch.doubt is not None:
        yield Obstacle(Need.CONSISTENT, who, detail=watch.doubt.text)
    boxes = [one.box for one in at.states_to_judge(participant, state)]
    excess_m = max(box_excess_m(box, at.spec.geofence) for box in boxes)
    yield from _limit_obstacle(Need.INSIDE, who, judge.outside_geofence(excess_m))
    for passed in judge.statement_violations(state, limits):
        if passed.code is not SafetyCode.LOCALISATION:
            meaning = MEANINGS[passed.code]
            limit = f"limit {passed.limit:g} {meaning.unit}"
            detail = f"{meaning.limit_name} {passed.measured:+.2f} {meaning.unit}, {limit}"
            yield Obstacle(Need.STATED, who, detail=detail)


def _young_for_triggers(at: Situation) -> Iterator[Obstacle]:
    if at.vut is None or at.spec.mode != "live":
        return
    # The newest state may lie here for a period before the next one comes.
    age_s, limit_s = at.age_s(at.vut) - at.spec.step_s, at.spec.trigger_age_s
    if not age_s <= limit_s:
        yield Obstacle(Need.TRIGGERS, at.spec.vut.id, age_s, limit_s)


def _apart(at: Situation) -> Iterator[Obstacle]:
    """Find pairs that would break the separation limit as soon as the run starts."""
    limits = at.spec.limits
    everyone = [at.states_to_judge(one, state) for one, state in at.present]
    for (i, ours), (k, others) in combinations(enumerate(everyone), 2):
        pairs = [(a, b) for a, b in product(ours, others) if a.is_finite and b.is_finite]
        near = [pair for pair in pairs if judge.separation(*pair, limits) is not None]
        if near:
            gap_m = min(box_distance(a.box, b.box) for a, b in near)
            who, other = everyone[k][0].object_id, everyone[i][0].object_id
            yield Obstacle(Need.APART, who, gap_m, limits.separation_m, other)


def _silent(sign: SignOfLife, silence_s: float, why: str = "") -> Iterator[Obstacle]:
    if not silence_s <= sign.arming_limit_s:
        yield Obstacle(_OF_SIGN[sign.code], sign.who, silence_s, sign.arming_limit_s, why)


def _limit_obstacle(need: Need, who: str, passed: LimitViolation | None) -> Iterator[Obstacle]:
    if passed is not None:
        yield Obstacle(need, who, passed.measured, passed.limit)


Check = Callable[[Situation], Iterator[Obstacle]]
_OF_CONNECT: tuple[Check, ...] = (_states_arrive, _receiver_gives_states)
# Everything that arming and starting ask for, in the order in which it is named.
CHECKS: tuple[Check, ...] = (
    *_OF_CONNECT,
    _bodies_ready,
    _not_refused,
    _one_manager,
    _same_rules,
    _nodes_live,
    _links_good,
    _stamps_good,
    _in_place,
    _young_for_triggers,
    _apart,
)
