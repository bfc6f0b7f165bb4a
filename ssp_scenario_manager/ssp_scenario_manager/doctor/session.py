"""The judgement of a session's connections without ROS: rates, stamps, frames, clocks, links.

``ssp doctor --session`` listens for some seconds and gives what it heard to ``session_findings``;
the last finding says what would keep the session from arming, by the manager's own rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

from ssp_core import names
from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.arming import Facts, Gate, obstacles
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import ConsistencyWatch
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.object_rules import RulesCheck, untold
from ssp_core.safety.start_heading import UNKNOWN_AT_REST
from ssp_core.vocabulary import SessionPhase
from ssp_scenario_manager.doctor.checks import Finding, Status, fail, ok

# A stream that comes at less than this share of its nominal rate is too slow to rely on.
RATE_SHARE = 0.8
# An object whose body had nothing new says its last state again. Its loop and its body's drift past
# each other, so that a few are sound; every second one comes of two publishers, or of a slow body.
REPEAT_SHARE = 0.2
# A clock that is off or a slow link makes every message late; a host that was busy once, ours too,
# makes a few.
LATE_SHARE = 0.05
# A pause of more than so many periods is worth a word.
PAUSE_PERIODS = 3.0
# Camera frames and recorder status may be this old when they arrive.
IMAGE_AGE_S = 0.5
_ARMED = (SessionPhase.ARMED, SessionPhase.RUNNING, SessionPhase.STOPPING)


@dataclass
class Stream:
    """The messages heard on one topic, arrivals and stamps in ns on the system clock.

    Args:
        frame_id: the frame that its messages must name, None where any will do.
    """

    frame_id: str | None = None
    arrivals_ns: list[int] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    strange_frames: set[str] = field(default_factory=set)

    def hear(self, arrival_ns: int, stamp_ns: int, frame_id: str) -> None:
        """Take one more message."""
        self.arrivals_ns.append(arrival_ns)
        self.stamps_ns.append(stamp_ns)
        if self.frame_id is not None and frame_id != self.frame_id:
            self.strange_frames.add(frame_id)

    @property
    def news_ns(self) -> list[int]:
        """List the arrivals of messages that don't repeat the previous stamp.

        A repeated message is no news: a publisher that froze has no rate, and pauses to the end.
        """
        before = (None, *self.stamps_ns)
        pairs = zip(self.arrivals_ns, self.stamps_ns, before, strict=False)
        return [arrival for arrival, stamp, last in pairs if stamp != last]

    @property
    def rate_hz(self) -> float:
        """News per second while messages came, 0 for fewer than two."""
        if len(self.news_ns) < 2:
            return 0.0
        span_s = ns_to_seconds(self.arrivals_ns[-1] - self.arrivals_ns[0])
        return (len(self.news_ns) - 1) / span_s if span_s > 0.0 else math.inf

    @property
    def longest_pause_s(self) -> float:
        """Measure the longest pause between two news, and after the last while messages came, s."""
        ends = [*self.news_ns, *self.arrivals_ns[-1:]]
        pairs = pairwise(ends)
        return max((ns_to_seconds(b - a) for a, b in pairs), default=0.0)

    @property
    def ages_s(self) -> list[float]:
        """Arrival minus stamp of each message, sorted; negative ones come from the future."""
        pairs = zip(self.arrivals_ns, self.stamps_ns, strict=True)
        return sorted(ns_to_seconds(arrival - stamp) for arrival, stamp in pairs)

    @property
    def going_back(self) -> int:
        """Messages whose stamp lies before the one before."""
        pairs = pairwise(self.stamps_ns)
        return sum(b < a for a, b in pairs)

    @property
    def repeated(self) -> int:
        """Count the messages that repeat the previous stamp."""
        return len(self.arrivals_ns) - len(self.news_ns)


@dataclass(frozen=True)
class SessionObservation:
    """Everything that was heard of a session.

    Args:
        streams: by topic, below the namespace; one for every topic that was listened to.
        states: the newest state of the VUT and each object, by id.
        lost: gaps in the sequence numbers of states, by id.
        links: as the manager has measured them, by object; empty when no manager was heard.
        managers: names of those that send heartbeats.
        recorder_ready: the recorder's last word, None when it wasn't heard.
        recorder_missing: what it waits for.
        vut_refused: why no state is made of the VUT's newest fix, as its adapter says.
        bodies: by object, what its process knows of its body.
        session: its state by the newest heartbeat; UNKNOWN without one.
        now_ns: end of listening, system clock.
        rules: of each object, held against the run's.
        frames: what objects that speak ISO 22133 sent to their gateway, by id; its clock.
        motion: what the VUT and the objects state, held against their places, by id.
        recorder_lost: messages that the recorder has lost.
        strangers: by topic, how many publish it and shouldn't, and a sentence that names them.
    """

    streams: dict[str, Stream]
    states: dict[str, ObjectState]
    lost: dict[str, int]
    links: dict[str, LinkEstimate]
    managers: frozenset[str]
    recorder_ready: bool | None
    recorder_missing: tuple[str, ...]
    now_ns: int
    session: SessionPhase = SessionPhase.UNKNOWN
    frames: dict[str, Stream] = field(default_factory=dict)
    rules: dict[str, RulesCheck] = field(default_factory=dict)
    vut_refused: str = ""
    bodies: Mapping[str, BodyStatus] = field(default_factory=dict)
    motion: dict[str, ConsistencyWatch] = field(default_factory=dict)
    recorder_lost: int = 0
    strangers: Mapping[str, tuple[int, str]] = field(default_factory=dict)


def session_findings(spec: RunSpec, observations: SessionObservation) -> list[Finding]:
    """Return one finding per thing that is connected, and what keeps the session from arming."""
    ids = spec.object_ids
    session_topics = {names.CAMERA_IMAGE, names.CAMERA_INFO, *ids}
    rate_hz, oldest_s = 1.0 / spec.step_s, spec.limits.state_age_s
    findings = []
    # What else was listened to is the GNSS/INS that the VUT's states are made of.
    for topic in sorted(observations.streams.keys() - session_topics):
        missing = f"nothing arrives on {names.absolute(topic)}"
        remedy = "is the driver of the GNSS/INS running, in this ROS domain?"
        stream = observations.streams[topic]
        silent = fail("odometry" if stream.frame_id else "navsat", missing, remedy)
        findings.append(_stream(silent, stream, rate_hz, oldest_s))
    for object_id in ids:
        missing = f"nothing arrives on {names.absolute(names.state_topic(object_id))}"
        remedy = "is its node running, in this ROS domain, with the same discovery server?"
        silent = fail(f"state of {object_id}", missing, remedy)
        stream, lost = observations.streams[object_id], observations.lost.get(object_id, 0)
        findings.append(_stream(silent, stream, rate_hz, oldest_s, lost))
    by_course = spec.limits.heading_by_course
    findings += [
        _motion(i, observations.motion[i], i in by_course) for i in ids if i in observations.motion
    ]
    findings += [_frames(spec, i, stream) for i, stream in sorted(observations.frames.items())]
    if spec.camera is not None:
        findings.append(_camera(spec.camera.rate_hz, observations))
    findings += [
        _recorder_finding(observations),
        _manager_finding(observations),
        _publishers_finding(observations),
    ]
    findings += [_rules_finding(t.id, observations) for t in spec.targets]
    findings += (
        [_link_finding(spec, t.id, observations) for t in spec.targets]
        if observations.managers
        else []
    )
    findings.append(_arming_finding(spec, observations))
    return findings


def _stream(
    silent: Finding, stream: Stream, nominal_hz: float, oldest_s: float, lost: int = 0
) -> Finding:
    """Judge a stream by its gravest problem; ``silent`` where nothing comes."""
    if not stream.arrivals_ns:
        return silent
    problems = _stream_problems(stream, nominal_hz, oldest_s)
    if lost:
        problems.append((Status.WARN, f"{lost} lost on the way"))
    statuses = [status for status, _ in problems]
    worst = next((s for s in (Status.FAIL, Status.WARN) if s in statuses), Status.OK)
    text = "; ".join([_stream_text(stream), *(problem for _, problem in problems)])
    return Finding(silent.name, worst, text, "" if worst is Status.OK else _remedy(stream))


def _motion(object_id: str, watch: ConsistencyWatch, by_course: bool) -> Finding:
    """Compare stated motion with places; near misses are for tuning before a day on the track."""
    known_later = f"; {UNKNOWN_AT_REST}" if by_course else ""
    name = f"motion of {object_id}"
    if watch.doubt is not None:
        remedy = "look at the axes, units and mounting of its source; then drive it again"
        return fail(name, f"contradicts its places: {watch.doubt.text}", remedy)
    counts = watch.counts
    if not counts.moving:
        return ok(
            name, f"it stood: speed, direction and yaw are judged while it moves{known_later}"
        )
    text = f"agrees with its places in {counts.total} windows, {counts.moving} moving"
    text += known_later
    if not counts.near_misses:
        return ok(name, text)
    near = f"{counts.near_misses} near misses, at most {counts.nearest:.0%} of the bound"
    remedy = "look at delays between places, heading and speed, and at the stated deviation"
    return Finding(name, Status.WARN, f"{text}; {near}", remedy)


def _frames(spec: RunSpec, object_id: str, stream: Stream) -> Finding:
    """Judge the rate of an ISO 22133 object's reports; their age is that of its states."""
    name, rate_hz, wanted_hz = f"frames of {object_id}", stream.rate_hz, 1.0 / spec.step_s
    pause_s, oldest_s = stream.longest_pause_s, spec.limits.state_age_s
    text = f"{rate_hz:.1f} Hz from the object, longest pause {pause_s:.3f} s"
    remedy = "look at the link to the object, and at the rate in its probe report"
    if rate_hz < RATE_SHARE * wanted_hz:
        return fail(name, f"{text}; the run wants {wanted_hz:g} Hz", remedy)
    if pause_s > oldest_s:
        return fail(name, f"{text}; limit {oldest_s:g} s", remedy)
    return ok(name, text)


def _camera(rate_hz: float, observations: SessionObservation) -> Finding:
    image, info = observations.streams[names.CAMERA_IMAGE], observations.streams[names.CAMERA_INFO]
    if image.arrivals_ns and not info.arrivals_ns:
        text = f"frames, but no calibration on {names.absolute(names.CAMERA_INFO)}"
        return fail("camera", text, "remap the driver's camera_info to it")
    missing = f"no frame arrives on {names.absolute(names.CAMERA_IMAGE)}"
    remedy = "remap the driver's compressed image to it"
    return _stream(fail("camera", missing, remedy), image, rate_hz, IMAGE_AGE_S)


def _stream_text(stream: Stream) -> str:
    ages = stream.ages_s
    middle = ages[len(ages) // 2]
    return f"{stream.rate_hz:.1f} Hz, stamps {middle * 1e3:.1f} ms old (at most {ages[-1]:.3f} s)"


def _stream_problems(
    stream: Stream, nominal_hz: float, oldest_s: float
) -> list[tuple[Status, str]]:
    """List the problems of a stream, each with its gravity."""
    problems = []
    if stream.rate_hz < RATE_SHARE * nominal_hz:
        problems.append((Status.FAIL, f"the run wants {nominal_hz:g} Hz"))
    if stream.longest_pause_s > PAUSE_PERIODS / nominal_hz:
        problems.append((Status.WARN, f"a pause of {stream.longest_pause_s:.3f} s"))
    ages = stream.ages_s
    if ages[-1] > oldest_s:
        late = sum(age > oldest_s for age in ages)
        text = f"stamps up to {ages[-1]:.3f} s old, limit {oldest_s:g} s ({late} of {len(ages)})"
        problems.append((Status.FAIL if late > LATE_SHARE * len(ages) else Status.WARN, text))
    if ages[0] < 0.0:
        problems.append((Status.FAIL, f"stamps up to {-ages[0]:.3f} s ahead of this host's clock"))
    if stream.going_back:
        problems.append((Status.FAIL, f"{stream.going_back} stamps before the one before"))
    if stream.repeated:
        often = stream.repeated > REPEAT_SHARE * len(stream.stamps_ns)
        text = f"{stream.repeated} of {len(stream.stamps_ns)} repeat the previous stamp"
        problems.append((Status.FAIL if often else Status.OK, text))
    if stream.strange_frames:
        frame_ids = ", ".join(repr(frame) for frame in sorted(stream.strange_frames))
        problems.append((Status.FAIL, f"frame {frame_ids}, must be {stream.frame_id!r}"))
    return problems


def _remedy(stream: Stream) -> str:
    if stream.repeated > REPEAT_SHARE * len(stream.stamps_ns) or stream.going_back:
        return "is it published twice, or is what it is made of slower than the run's rate?"
    if stream.strange_frames:
        return "set the driver's frame, or put a transform in between"
    if stream.ages_s[0] < 0.0 or stream.ages_s[0] > 0.05:
        return "synchronise the clocks (chrony or PTP), and stamp when measured"
    return "look at the link's load and the driver's rate"


def _recorder_finding(observations: SessionObservation) -> Finding:
    if observations.recorder_ready is None:
        return fail("recorder", "silent", "start ssp_monitor's node")
    if not observations.recorder_ready:
        waits = ", ".join(observations.recorder_missing) or "its file"
        return fail("recorder", f"waits for {waits}", "start what publishes them")
    if observations.recorder_lost:
        lost = f"has lost {observations.recorder_lost} messages"
        return fail("recorder", lost, "look at its host's load and disk; begin a new session")
    return ok("recorder", "ready")


def _manager_finding(observations: SessionObservation) -> Finding:
    name, managers = "scenario_manager", ", ".join(sorted(observations.managers))
    if not observations.managers:
        silent = "no heartbeat, so that links and clocks can't be measured"
        return fail(name, silent, "start it; it may stay IDLE")
    if len(observations.managers) > 1:
        many = f"{len(observations.managers)} send heartbeats: {managers}"
        return fail(name, many, "end all but one, or separate them by ROS_DOMAIN_ID")
    return ok(name, f"heartbeats of {managers}")


def _publishers_finding(observations: SessionObservation) -> Finding:
    """Tell whether each topic has the publishers that it should have."""
    if observations.strangers:
        remedy = "end what doesn't belong to this session, or separate it by ROS_DOMAIN_ID"
        return fail(
            "publishers", "; ".join(text for _, text in observations.strangers.values()), remedy
        )
    return ok("publishers", "no stranger publishes a topic of this session")


def _rules_finding(object_id: str, observations: SessionObservation) -> Finding:
    """Tell whether an object judges by the limits of this run's file."""
    name, rules = f"rules of {object_id}", observations.rules.get(object_id, untold(object_id))
    if not rules.digest:
        return fail(name, rules.problem, "start its object_target, of this version, on its host")
    if rules.problem:
        remedy = "give its host this run's folder and this version, and start its node anew"
        return fail(name, rules.problem, remedy)
    return ok(name, "; ".join(("as in this run", *(f"its own {one}" for one in rules.stricter))))


def _link_finding(spec: RunSpec, object_id: str, observations: SessionObservation) -> Finding:
    name, limits = f"link to {object_id}", spec.limits
    link = observations.links.get(object_id, LinkEstimate())
    if not math.isfinite(link.delay_s):
        remedy = "is its object_target active? The manager measures links of a loaded run only"
        return fail(name, "heartbeats aren't answered", remedy)
    text = f"clock off by {link.offset_s * 1e3:+.1f} ms, {link.delay_s * 1e3:.1f} ms there and back"
    for one in judge.link_violations(link.offset_s, link.delay_s, limits):
        if one.code is SafetyCode.LINK_DELAY:
            return fail(name, f"{text}; limit {one.limit:g} s", "look at the radio link")
        limit = f"{text}; limit ±{one.limit:g} s"
        return fail(name, limit, "synchronise the clocks (chrony or PTP)")
    return ok(name, text)


def _arming_finding(spec: RunSpec, observations: SessionObservation) -> Finding:
    """Report the manager's answer to ``arm`` now, by the same rules; an armed one is not asked."""
    if observations.session in _ARMED:
        text = (
            f"the session is {observations.session.name} already, so that nothing is asked of "
            "arming"
        )
        return ok("arming", text)
    streams = observations.streams
    ages_s = {i: _age_s(streams[i], observations.now_ns) for i in spec.object_ids}
    # Of a simulated world the states of the VUT are the sign.
    ages_s[names.SIL_WORLD] = ages_s[spec.vut.id]
    ages_s[names.MONITOR] = math.inf if observations.recorder_ready is None else 0.0
    ages_s[names.FRONT_CAMERA] = _age_s(streams.get(names.CAMERA_IMAGE), observations.now_ns)
    facts = Facts(
        ages_s=ages_s,
        recorder_ready=bool(observations.recorder_ready),
        recorder_missing=observations.recorder_missing,
        recorder_lost=observations.recorder_lost,
        vut_refused=observations.vut_refused,
        bodies=observations.bodies,
        motion=observations.motion,
        links={i: replace(link, age_s=0.0) for i, link in observations.links.items()},
        rules=observations.rules,
        other_managers=max(
            sum(count for count, _ in observations.strangers.values()),
            len(observations.managers) - 1,
            0,
        ),
        foreign="; ".join(text for _, text in observations.strangers.values()),
    )
    targets = {i: state for i, state in observations.states.items() if i != spec.vut.id}
    vut = observations.states.get(spec.vut.id)
    missing = obstacles(Gate.ARM, spec, facts, vut, targets, observations.now_ns)
    if missing:
        text = "; ".join(obstacle.text for obstacle in missing)
        return fail("arming", text, "see the findings above")
    return ok("arming", "nothing keeps this session from arming")


def _age_s(stream: Stream | None, now_ns: int) -> float:
    if stream is None or not stream.arrivals_ns:
        return math.inf
    return ns_to_seconds(now_ns - stream.arrivals_ns[-1])


def failed(findings: Sequence[Finding]) -> bool:
    """Tell whether one of the findings failed."""
    return any(finding.status is Status.FAIL for finding in findings)
