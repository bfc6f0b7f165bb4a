"""Supervision on the steady clock: silent participants, overdue waits, the manager's lateness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.arming import ARM_AGAIN_S, Facts
from ssp_core.safety.body_status import BodyStatus, known_bodies
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import WINDOW_S, LinkClocks
from ssp_core.safety.liveness import (
    ADAPTER_SILENT_S,
    WATCHED,
    WORLD_SILENT_LOCKSTEP_S,
    SignOfLife,
    lockstep_participants,
    signs_of_life,
)
from ssp_core.safety.object_rules import ReceivedRules
from ssp_core.safety.publishers import LONGEST_TOLD, MOST_TOLD
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session.limits import LATE_S, Violation, of_object, silent, too_many
from ssp_scenario_manager.session.session import Session

# A gap between two looks that is no lateness yet: two periods of the watchdog.
_PUNCTUAL_S = 0.1


class LivenessMonitor:
    """Last sign of life of each participant. Reads no clock: times are given, in ns."""

    def __init__(self, links: LinkClocks | None = None) -> None:
        self.links = links or LinkClocks()
        self.rules = ReceivedRules()
        self.recorder_ready = False
        self.recorder_missing: tuple[str, ...] = ()
        self.recorder_lost = 0
        self._vut_refused = ""
        # By topic that one node alone may publish: how many others do, and who.
        self.foreign: dict[str, tuple[int, str]] = {}
        self._last_sign_ns: dict[str, int] = {}
        self._responders: set[str] = set()
        self._bodies: dict[str, tuple[BodyStatus, int]] = {}
        # Of the last command to arm: by object, why not, and when the last refusal came.
        self._refusals: dict[str, str] = {}
        self._refusal_lasts = False
        self._refused_ns = 0
        self._table: tuple[RunSpec, SessionPhase, tuple[SignOfLife, ...]] | None = None

    def hear(self, who: str, steady_ns: int) -> None:
        self._last_sign_ns[who] = steady_ns

    def hear_hold(self, steady_ns: int) -> None:
        """Take the world's word that it holds at a step for a driver's answer.

        Until it goes on there is no state of the VUT, and no frame.
        """
        for who in (names.VUT_ID, names.FRONT_CAMERA):
            if who in self._last_sign_ns:
                self.hear(who, steady_ns)

    def excuse(self, pause_ns: int, steady_ns: int) -> None:
        """Excuse others' silence in a pause in which the manager itself heard nothing."""
        for who, heard_ns in self._last_sign_ns.items():
            self._last_sign_ns[who] = min(heard_ns + pause_ns, steady_ns)

    def hear_recorder(
        self, ready: bool, missing: tuple[str, ...], lost: int, steady_ns: int
    ) -> None:
        """Take the recorder's report on itself (RecorderStatus.msg)."""
        self.hear(names.MONITOR, steady_ns)
        self.recorder_ready, self.recorder_missing, self.recorder_lost = ready, missing, lost

    def hear_answer(self, participant: str) -> None:
        """Take a participant's answer to a step of the simulated world (StepDone.msg)."""
        self._responders.add(participant)

    def hear_strangers(self, texts: Sequence[str]) -> None:
        """Take topics with more publishers than they should have, by their messages' numbers."""
        self.foreign.pop(names.MONITOR, None)
        if texts:
            self.foreign[names.MONITOR] = len(texts), "; ".join(texts)

    def hear_localisation(self, reason: str, steady_ns: int) -> None:
        """Take the reason why no state is made of the VUT's newest fix; empty: one is made."""
        self.hear(names.VUT_ADAPTER, steady_ns)
        self._vut_refused = reason

    def hear_body(self, status: BodyStatus, steady_ns: int) -> None:
        """Take the report of a live object's process on its body (BodyStatus.msg)."""
        self._bodies[status.object_id] = status, steady_ns

    def begin_arming(self) -> None:
        """Forget refusals, since all objects are asked anew."""
        self._refusals, self._refusal_lasts = {}, False

    def hear_refusal(self, object_id: str, text: str, lasting: bool, steady_ns: int) -> None:
        """Take an object's refusal to arm.

        Args:
            object_id: of the object.
            text: its reason.
            lasting: it will refuse as long as its process runs as it was started.
            steady_ns: now, on the steady clock.
        """
        self._refusals[object_id] = text
        self._refusal_lasts |= lasting
        self._refused_ns = steady_ns

    @property
    def other_managers(self) -> int:
        return sum(count for count, _ in self.foreign.values())

    @property
    def strangers(self) -> tuple[str, ...]:
        """Return those that the manager itself has found; the recorder reports its own."""
        texts = (text for who, (_, text) in self.foreign.items() if who != names.MONITOR)
        return tuple(text[:LONGEST_TOLD] for text in islice(texts, MOST_TOLD))

    @property
    def foreign_text(self) -> str:
        return "; ".join(text for _, text in self.foreign.values())

    def age_s(self, who: str, steady_ns: int) -> float:
        """Return seconds since the last sign of life, inf before the first."""
        sign_ns = self._last_sign_ns.get(who)
        return math.inf if sign_ns is None else ns_to_seconds(steady_ns - sign_ns)

    def facts(self, spec: RunSpec | None, steady_ns: int) -> Facts:
        """Return the facts that readiness asks for beside the states."""
        ids = [target.id for target in spec.targets] if spec else []
        refused = steady_ns - self._refused_ns <= seconds_to_ns(ARM_AGAIN_S)
        adapted = self.age_s(names.VUT_ADAPTER, steady_ns) <= ADAPTER_SILENT_S
        live = spec is not None and spec.mode == "live"
        bodies = known_bodies(ids, self._bodies, steady_ns) if live else {}
        in_steps = spec is not None and spec.mode == "lockstep"
        awaited = lockstep_participants(spec) if spec is not None and in_steps else ()
        return Facts(
            ages_s={who: self.age_s(who, steady_ns) for who in self._last_sign_ns},
            links={i: self.links.link(i, steady_ns) for i in ids},
            recorder_ready=self.recorder_ready,
            recorder_missing=self.recorder_missing,
            recorder_lost=self.recorder_lost,
            unanswered=tuple(who for who in awaited if who not in self._responders),
            vut_refused=self._vut_refused if adapted else "",
            rules=self.rules.checks(spec) if spec else {},
            other_managers=self.other_managers,
            foreign=self.foreign_text,
            bodies=bodies,
            refusals=dict(self._refusals) if refused else {},
            lasting=refused and self._refusal_lasts,
        )

    def violations(
        self, spec: RunSpec, phase: SessionPhase, steady_ns: int, stamp_ns: int
    ) -> list[Violation]:
        """Find participants that are silent for too long, have too bad a link, or are too many.

        In lockstep, what a run is judged by counts simulated time, so that here are only those
        whose death stops that time, and before the run everybody.

        Args:
            spec: the run; says its mode, and whether there is a camera.
            phase: of the session: ARMED, RUNNING or STOPPING.
            steady_ns: now, on the clock of ``hear``.
            stamp_ns: session time, for the events.
        """
        findings: list[Violation | None] = []
        for sign in self._watched(spec, phase):
            silence_s = self._silence_s(sign, steady_ns)
            if not silence_s <= sign.limit_s:  # what is no number is silent too
                findings.append(silent(sign.code, sign.who, silence_s, sign.limit_s, stamp_ns))
        lost, others = self.recorder_lost, self.other_managers
        detail = "messages lost by the recorder"
        findings.append(too_many(SafetyCode.RECORDER, lost, stamp_ns, detail))
        findings.append(too_many(SafetyCode.FOREIGN_MANAGER, others, stamp_ns, self.foreign_text))
        if spec.mode != "lockstep":
            for target in spec.targets:
                findings += self._of_link(spec, target.id, steady_ns, stamp_ns)
        return [violation for violation in findings if violation is not None]

    def _watched(self, spec: RunSpec, phase: SessionPhase) -> tuple[SignOfLife, ...]:
        """Return the signs that are counted by arrival in a phase.

        They are kept, since every look of the watchdog asks for them.
        """
        if self._table is None or self._table[0] is not spec or self._table[1] is not phase:
            signs = signs_of_life(spec)
            signs_in_phase = tuple(one for one in signs if phase in one.phases and not one.by_stamp)
            self._table = spec, phase, signs_in_phase
        return self._table[2]

    def _silence_s(self, sign: SignOfLife, steady_ns: int) -> float:
        """Return seconds since a sign that is counted by arrival, inf before the first."""
        if sign.code is SafetyCode.REPLY_MISSING:
            return self.links.link(sign.who, steady_ns).age_s
        return self.age_s(sign.who, steady_ns)

    def _of_link(
        self, spec: RunSpec, object_id: str, steady_ns: int, stamp_ns: int
    ) -> list[Violation | None]:
        """Judge the answers to heartbeats; a link that isn't measured is silent by its age."""
        link, limits = self.links.link(object_id, steady_ns), spec.limits
        if not math.isfinite(link.delay_s):
            return []
        passed = judge.link_violations(link.offset_s, link.delay_s, limits)
        return [of_object(one, object_id, stamp_ns, "measured by heartbeats") for one in passed]


# Longer than the process of an object waits for its body, which says what that reports instead.
ARM_CONFIRMATION_S = 4.0
ABORT_STANDSTILL_S = 15.0
# Nobody waits for the standstill of what has not been heard for this long.
SILENT_S = 1.0


# What was measured over the links while the manager was late is believed for link_quality.WINDOW_S.
_REMEMBERED_S = WINDOW_S + 0.5


class AbortWatch:
    """The watch that finds, after an abort, that no participant can report the standstill."""

    def __init__(self) -> None:
        self._since_ns: tuple[int, int] | None = None

    def unconfirmed(
        self, session: Session, liveness: LivenessMonitor, steady_ns: int, now_ns: int
    ) -> bool:
        """Tell whether a dead world can't report a standstill; the result must still be given."""
        if session.state is not SessionPhase.ABORTING:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = steady_ns, now_ns
        waited_s = ns_to_seconds(steady_ns - self._since_ns[0])
        # The world was silent while it waited for a participant that died; it goes on after that.
        spec = session.spec
        has_world = spec is None or spec.mode != "live"
        # A simulated world that goes on may be far ahead of the steady clock.
        simulated_s = ns_to_seconds(now_ns - self._since_ns[1]) if has_world else 0.0
        world_age_s = liveness.age_s(names.SIL_WORLD, steady_ns)
        # In lockstep nothing is heard while the world waits for the slowest.
        lockstep = spec is not None and spec.mode == "lockstep"
        limit_s = WORLD_SILENT_LOCKSTEP_S if lockstep else SILENT_S
        world_dead = has_world and min(world_age_s, waited_s) > limit_s
        paused_s = min(world_age_s, limit_s) if lockstep else 0.0
        ids = [t.id for t in spec.targets] if spec else []
        silent = [i for i in ids if liveness.age_s(i, steady_ns) > SILENT_S + paused_s]
        others_stand = bool(silent) and session.stands(now_ns, without=silent)
        return world_dead or others_stand or max(waited_s, simulated_s) > ABORT_STANDSTILL_S


class Supervisor:
    """Silence, links and timeouts of a session."""

    def __init__(self, session: Session, liveness: LivenessMonitor) -> None:
        self._session = session
        self._liveness = liveness
        self._arming_since_ns: int | None = None
        self._abort = AbortWatch()
        self._awake_ns: int | None = None
        self._late = 0, 0.0

    def on_arm_commands(self, steady_ns: int) -> None:
        self._arming_since_ns = steady_ns
        self._liveness.begin_arming()

    def wake(self, steady_ns: int) -> None:
        """Record a wake-up of the manager, and how late it was of late."""
        pause_ns = 0 if self._awake_ns is None else steady_ns - self._awake_ns
        if pause_ns > seconds_to_ns(LATE_S):
            spec = self._session.spec
            if spec is not None and spec.mode == "lockstep":
                self._liveness.excuse(pause_ns, steady_ns)
        self._awake_ns = steady_ns
        if steady_ns - self._late[0] > seconds_to_ns(_REMEMBERED_S):
            self._late = steady_ns, 0.0
        if pause_ns > seconds_to_ns(_PUNCTUAL_S) and ns_to_seconds(pause_ns) >= self._late[1]:
            self._late = steady_ns, ns_to_seconds(pause_ns)
        self._session.late_s = self._late[1]

    def look(self, steady_ns: int, now_ns: int) -> bool:
        """Tell the session what is known now, and end what has waited for too long.

        A session stays armed only if every object says in time that it is.

        Returns:
            True when the session aborts and no participant is left to report a standstill.
        """
        self.wake(steady_ns)
        session = self._session
        self.inform(steady_ns)
        self.watch_silence(steady_ns, now_ns)
        session.name_strangers((text for _, text in self._liveness.foreign.values()), now_ns)
        if (reason := self._not_armed(steady_ns)) is not None:
            session.arming_failed(now_ns, reason)
        return self._abort.unconfirmed(session, self._liveness, steady_ns, now_ns)

    def inform(self, steady_ns: int) -> None:
        """Give the session the facts that a command is judged by, as they are now."""
        self._session.facts = self._liveness.facts(self._session.spec, steady_ns)

    def watch_silence(self, steady_ns: int, now_ns: int) -> None:
        """End a session in which a participant is silent for too long."""
        spec, state = self._session.spec, self._session.state
        if spec is not None and state in WATCHED:
            for violation in self._liveness.violations(spec, state, steady_ns, now_ns):
                self._session.fail(violation)

    def _not_armed(self, steady_ns: int) -> str | None:
        """Give the reason why the session can't stay armed.

        None without one, or while time is left.
        """
        spec, targets = self._session.spec, self._session.targets
        since_ns = self._arming_since_ns
        if since_ns is None or spec is None:
            return None
        waiting = [
            target.id
            for target in spec.targets
            if (state := targets.get(target.id)) is None
            or state.control_state is not ControlState.ARMED
        ]
        if not waiting or self._session.state is not SessionPhase.ARMED:
            self._arming_since_ns = None
        elif steady_ns - since_ns > seconds_to_ns(ARM_CONFIRMATION_S):
            self._arming_since_ns = None
            return f"{', '.join(waiting)} did not arm in {ARM_CONFIRMATION_S:g} s"
        return None
