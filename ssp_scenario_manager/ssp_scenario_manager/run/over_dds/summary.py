"""The facts that people must see before they give the word that starts a live session."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from types import MappingProxyType

from ssp_core import names
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.participation import Participation
from ssp_core.safety.arming import Facts
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.start_heading import UNKNOWN_AT_REST
from ssp_scenario_manager.run.over_dds.live import LiveSetup
from ssp_scenario_manager.run.over_dds.word import ABORT, HOLDS_S, START
from ssp_scenario_manager.session.preconditions import FRESH_S
from ssp_scenario_manager.session.run import blind_text

LOST_S = 3.0
_FIGURE = re.compile(r"[0-9]+(?:\.[0-9]+)?")
PROMPT = (
    f'type "{START}" to connect, arm and start: objects drive off at once. It is valid '
    f'for {HOLDS_S:g} s. "{ABORT}" and Ctrl-C cancel now, and abort once the run has begun; '
    "anything else asks again"
)


def summary(
    spec: RunSpec,
    setup: LiveSetup,
    facts: Facts,
    states: Mapping[str, ObjectState],
    took_part: Participation | None = None,
) -> list[str]:
    """List who is connected and real, mode, distances to the starts, limits, and blind distance.

    Who isn't connected, or can't be armed, has the reason, as far as its process knows it.

    Args:
        spec: the run.
        setup: which objects and localisation are of this host.
        facts: what is heard beside the states, and their ages.
        states: the newest one of the VUT and of each object, by id.
        took_part: what the participants declare themselves to be; None: nothing is known of it.
    """
    limits = spec.limits
    lines = [f"mode {spec.mode}: {spec.scenario} on {spec.site}, session {spec.session_token}"]
    connections = connected(spec, facts)
    why = causes(spec, facts, connections)
    for one in (spec.vut, *spec.targets):
        place = "; ".join((_place(spec, one, facts, states.get(one.id)), *why[one.id]))
        lines.append(f"  {one.id}, {_kind(spec, setup, one.id)}: {place}")
    recorder = "ready" if facts.recorder_ready else "not ready"
    if not connections[names.MONITOR]:
        recorder = "not heard"
    camera = ""
    if names.FRONT_CAMERA in connections:
        camera = f", camera {'sends' if connections[names.FRONT_CAMERA] else 'silent'}"
    return [
        *lines,
        f"  recorder {recorder}{camera}",
        *(f"  {who}: {text}" for who, text in strangers(facts)),
        *((f"  what takes part: {took_part.text}",) if took_part is not None else ()),
        f"  limits: {limits.speed_mps:g} m/s, {limits.acceleration_mps2:g} m/s², "
        f"{limits.separation_m:g} m apart, {limits.duration_s:g} s long, "
        f"stop at {limits.stop_deceleration_mps2:g} m/s²",
        f"  {blind_text(limits)}",
    ]


def connected(
    spec: RunSpec, facts: Facts, before: Mapping[str, bool] = MappingProxyType({})
) -> dict[str, bool]:
    """Tell of the VUT, each object, the recorder and the camera whether they are heard.

    Args:
        spec: the run.
        facts: what is heard, with ages.
        before: the last answer; those that were heard then are until they are silent for LOST_S.
    """
    limits_s = dict.fromkeys((spec.vut.id, *(t.id for t in spec.targets)), spec.limits.state_age_s)
    limits_s[names.MONITOR] = FRESH_S
    if spec.camera is not None:
        limits_s[names.FRONT_CAMERA] = FRESH_S
    return {
        who: _age_s(facts, who) <= (max(limit_s, LOST_S) if before.get(who) else limit_s)
        for who, limit_s in limits_s.items()
    }


def strangers(facts: Facts) -> list[tuple[str, str]]:
    """Name the publishers that keep this session from being armed; empty: there are none."""
    return [("strangers", f"can't be armed: {facts.foreign}")] if facts.foreign else []


def causes(
    spec: RunSpec, facts: Facts, connections: Mapping[str, bool]
) -> dict[str, tuple[str, ...]]:
    """Say of the VUT and of each object why it isn't heard, and what keeps it from being armed.

    Args:
        spec: the run.
        facts: what the processes say of receiver and bodies.
        connections: who is connected.
    """
    reasons_by_id: dict[str, tuple[str, ...]] = {spec.vut.id: ()}
    if facts.vut_refused:
        reasons_by_id[spec.vut.id] = (f"its GNSS/INS gives no state: {facts.vut_refused}",)
    for target in spec.targets:
        body = facts.bodies.get(target.id, BodyStatus(target.id))
        why = () if connections[target.id] else body.no_state
        obstacles = (text for text in body.cannot_arm if text not in why)
        reasons_by_id[target.id] = (*why, *(f"can't be armed: {text}" for text in obstacles))
    return reasons_by_id


class PromptFacts:
    """The connections and reasons that a person has seen at the prompt.

    Args:
        spec: the run.
        facts: that the summary was made of.
    """

    def __init__(self, spec: RunSpec, facts: Facts) -> None:
        self._spec = spec
        self._connections = connected(spec, facts)
        self._causes = {_like(who, text) for who, text in self._all(facts)}

    def news(self, facts: Facts) -> list[str]:
        """List who came or went, and each reason that wasn't shown yet, a line each."""
        connections = connected(self._spec, facts, self._connections)
        lines = changes(self._connections, connections)
        self._connections = connections
        for who, text in self._all(facts):
            if (cause := _like(who, text)) not in self._causes:
                self._causes.add(cause)
                lines.append(f"{who}: {text}")
        return lines

    def _all(self, facts: Facts) -> list[tuple[str, str]]:
        reasons_by_id = causes(self._spec, facts, self._connections)
        return [(who, text) for who, texts in reasons_by_id.items() for text in texts] + strangers(
            facts
        )


def _like(who: str, text: str) -> tuple[str, str]:
    """Return a reason without its figures, which may change twice a second."""
    return who, _FIGURE.sub("", text)


def changes(before: Mapping[str, bool], now: Mapping[str, bool]) -> list[str]:
    """List each of them that came or went since the summary was shown, a line each."""
    return [
        f"{who}: {'connected now' if here else 'NOT CONNECTED any more'}"
        for who, here in now.items()
        if here != before[who]
    ]


def _age_s(facts: Facts, who: str) -> float:
    return facts.ages_s.get(who, math.inf)


def _kind(spec: RunSpec, setup: LiveSetup, object_id: str) -> str:
    """Tell whether a real object may move with it."""
    if object_id == spec.vut.id:
        if topic := setup.receiver.get("odometry") or setup.receiver.get("navsat"):
            return f"taken as real, by {topic}"
        return "assumed real (another node publishes its states)"
    address = setup.bodies.get(object_id)
    if address is None:
        return "assumed real (another host controls it)"
    return "mirror, nothing real moves" if address == "mirror" else f"taken as real, body {address}"


def _place(spec: RunSpec, one: ParticipantSpec, facts: Facts, state: ObjectState | None) -> str:
    age_s = _age_s(facts, one.id)
    if state is None:
        return f"NOT CONNECTED, nothing comes on {names.absolute(names.state_topic(one.id))}"
    if age_s > spec.limits.state_age_s:
        return f"NOT CONNECTED, last heard {age_s:.1f} s ago"
    away_m = math.hypot(state.x_m - one.start.x_m, state.y_m - one.start.y_m)
    far = "" if away_m <= spec.limits.start_region_m else "TOO FAR, "
    control = "" if one.id == spec.vut.id else f"{state.control_state.name}, "
    by_course = one.id in spec.limits.heading_by_course
    heading = f"; {UNKNOWN_AT_REST}" if by_course else ""
    return (
        f"connected, {control}{far}{away_m:.2f} m from its start (limit "
        f"{spec.limits.start_region_m:g} m), {state.speed_mps:.1f} m/s{heading}"
    )
