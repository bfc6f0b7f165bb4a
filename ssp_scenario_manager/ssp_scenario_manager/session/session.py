"""The session: commands and states in; transitions, references and events out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from ssp_core import names
from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import arming
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.liveness import WATCHED
from ssp_core.safety.publishers import NAMELESS
from ssp_core.safety.start_heading import UNKNOWN_AT_REST
from ssp_core.vocabulary import ControlState, Phase, SessionPhase, Verdict
from ssp_scenario_manager.dispatch import references
from ssp_scenario_manager.session import limits, outbox, preconditions, progress
from ssp_scenario_manager.session.run import Run
from ssp_scenario_manager.session.state_machine import (
    REFUSED_CONDITION,
    REFUSED_TRANSITION,
    STANDSTILL_GIVEN_UP,
    Answer,
    IllegalTransition,
    SessionEvent,
    next_state,
)
from ssp_scenario_manager.triggers import fireability

# Commands that need something of everybody.
_GATES = {
    SessionEvent.CONNECT: arming.Gate.CONNECT,
    SessionEvent.ARM: arming.Gate.ARM,
    SessionEvent.START: arming.Gate.START,
}

_FOREIGN = MEANINGS[SafetyCode.FOREIGN_MANAGER].limit_name


class Session:
    """State machine, triggers, dispatch and supervision of one session.

    Attributes:
        aborts: how many there were, repeated ones included.
        vut: newest state of the VUT.
        targets: newest states of the object targets, by id.
    """

    def __init__(self) -> None:
        self.state = SessionPhase.IDLE
        self.outbox: list[outbox.Outgoing] = []
        self.facts = arming.Facts()
        self.aborts = 0
        self.late_s = 0.0  # how late the manager was of late, as its watchdog says
        self._run: Run | None = None
        self.vut: ObjectState | None = None
        self.targets: dict[str, ObjectState] = {}
        self._senders: set[str] = set()  # who has sent a state since the last abort
        self._standstill_given_up = False

    # -- what others may look at --------------------------------------------------------------

    @property
    def spec(self) -> RunSpec | None:
        return self._run.spec if self._run else None

    @property
    def verdict(self) -> Verdict:
        return self._run.verdict.value if self._run else Verdict.NONE

    @property
    def reasons(self) -> tuple[str, ...]:
        return tuple(self._run.verdict.reasons) if self._run else ()

    @property
    def phase(self) -> Phase:
        return self._run.event.phase if self._run else Phase.UNKNOWN

    def elapsed_s(self, now_ns: int) -> float:
        """Return the session time since the start of the run, 0 before it."""
        return self._run.elapsed_s(now_ns) if self._run else 0.0

    # -- commands ------------------------------------------------------------------------------

    def load(self, spec: RunSpec, now_ns: int) -> Answer:
        """Take a run that was read and validated."""
        problems = fireability.cannot_fire(spec)
        if problems:
            return Answer(False, REFUSED_CONDITION, "; ".join(problems), tuple(problems))
        try:
            next_state(self.state, SessionEvent.LOAD)
        except IllegalTransition as error:
            return Answer(False, REFUSED_TRANSITION, str(error))
        if spec.vut.approach is None:
            raise ValueError("a run without a path for the VUT passed the checks")
        self._run = Run(spec, Polyline(spec.vut.approach.path), now_ns)
        references.prepare(spec)
        # What was heard so far belongs to another run.
        self.vut, self.targets, self._senders = None, {}, set()
        self._move(SessionEvent.LOAD, now_ns, f"{spec.scenario} on {spec.site}")
        return Answer(True)

    def command(self, event: SessionEvent, now_ns: int, requested_by: str, reason: str) -> Answer:
        """Take connect, arm, disarm, start, stop, abort, all_clear or reset.

        Raises:
            ValueError: the event is no command.
        """
        if event.value not in names.SESSION_COMMANDS:
            raise ValueError(f"{event.value} is no command")
        if event is SessionEvent.ABORT:
            self._abort_by_operator(now_ns, requested_by, reason)
            return Answer(True)
        try:
            next_state(self.state, event)
        except IllegalTransition as error:
            return Answer(False, REFUSED_TRANSITION, str(error))
        missing = self._missing_for(event, now_ns)
        if missing:
            text = f"{event.value} refused: " + "; ".join(missing)
            final = event is SessionEvent.ARM and self.facts.is_hopeless
            return Answer(False, REFUSED_CONDITION, text, tuple(missing), is_final=final)
        if event is SessionEvent.STOP and self._run is not None:
            self._run.end_early(requested_by, now_ns)
        why = reason or f"requested by {requested_by}"
        if event is SessionEvent.ALL_CLEAR and self._run is None:
            why += (
                "; no run is loaded, so no object was cleared: load theirs, abort and clear again"
            )
        if event is SessionEvent.ARM and self._run is not None:
            why += f"; {self._run.blind_text}"
            for object_id, rules in self.facts.rules.items():
                why += "".join(f"; {object_id} has its own {one}" for one in rules.stricter)
            why += "".join(f"; {who}: {UNKNOWN_AT_REST}" for who in self._run.history.headings)
        self._move(event, now_ns, why)
        if event is SessionEvent.ARM and self._run is not None:
            self._run.armed = True
            self.outbox.append(outbox.ObjectCommand.ARM)
        elif event is SessionEvent.DISARM:
            self.outbox.append(outbox.ObjectCommand.DISARM)
        elif event is SessionEvent.START and self._run is not None:
            self._take(progress.begin(self._run, now_ns))
        elif event is SessionEvent.ALL_CLEAR:
            self.outbox.append(outbox.ObjectCommand.ALL_CLEAR)
        elif event is SessionEvent.RESET:
            self._run = None
        return Answer(True)

    def arming_failed(self, now_ns: int, reason: str) -> None:
        """Take an object's refusal to arm, or its missing answer."""
        if self.state is SessionPhase.ARMED:
            self._move(SessionEvent.ARM_FAILED, now_ns, reason)
            self.outbox.append(outbox.ObjectCommand.DISARM)

    # -- what arrives --------------------------------------------------------------------------

    def refuse_if_ahead(self, state: ObjectState, now_ns: int) -> bool:
        """End a run that lasts for a VUT's state from the future; return True where it is refused.

        Session time would follow it, and all that is right would be too old after it.

        Args:
            state: that arrives, before it is taken.
            now_ns: session time; a simulated world may be a step further.
        """
        run = self._run
        if run is None or not self._lasts or state.object_id != run.spec.vut.id:
            return False
        early_s = 0.0 if run.spec.mode == "live" else run.spec.step_s
        ahead = limits.stamp_ahead(state, now_ns, early_s, run.spec.limits)
        if ahead is not None:
            self.fail(ahead)
        return ahead is not None

    def on_vut_state(self, state: ObjectState) -> bool:
        """Take a state of the VUT; return False for one of another object, which has no effect."""
        if self._run is not None and state.object_id != self._run.spec.vut.id:
            return False
        if self._hear(state, self.vut):
            self.vut = state
        return True

    def on_target_state(self, state: ObjectState) -> bool:
        """Take a state of a target; return False for an unknown object's, which has no effect."""
        who, run = state.object_id, self._run
        if run is not None and who not in run.target_ids:
            return False
        if self._hear(state, self.targets.get(who)):
            self.targets[who] = state
        return True

    def _hear(self, state: ObjectState, last_state: ObjectState | None) -> bool:
        """Judge a state that counts; while a run lasts, one older than what is known doesn't.

        Otherwise what came last is the truth: a clock that was wrong must not outlast its
        correction.

        Returns:
            True for a state that counts.
        """
        self._senders.add(state.object_id)
        if last_state is not None and state.stamp_ns < last_state.stamp_ns and self._lasts:
            return False
        if self._run is not None:
            self._run.see(state)
        return True

    @property
    def _lasts(self) -> bool:
        return self.state in WATCHED or self.state is SessionPhase.ABORTING

    def on_ack(
        self, reference_id: str, accepted: bool, code: int, message: str, now_ns: int
    ) -> None:
        """Take an object's answer to a reference; a refusal aborts the session.

        An object that has stopped refuses the references that were on their way to it. The reason
        should be why it stopped, which its event or state reports. The refusal itself counts only
        if neither arrives.
        """
        run = self._run
        if run is None:
            return
        refused = run.dispatches.answer(reference_id, accepted, code, message, now_ns)
        if refused is None:
            return
        if code == references.NOT_RUNNING:
            if self.state is SessionPhase.ABORTING:
                return
            target_state = self.targets.get(refused.object_id)
            control = ControlState.OFF if target_state is None else target_state.control_state
            if control in (ControlState.RUNNING, ControlState.ABORTING):
                run.local_stops.take_refusal(refused)
                return
        self.fail(refused)

    def take_report(self, reported: limits.Violation, now_ns: int) -> None:
        """Take a limit that another node saw passed, and has announced.

        A latched report of an earlier live session ends none that only waits; from arming on every
        report counts. In simulation the stamps of all sessions begin at 0.
        """
        run = self._run
        if run is not None and run.spec.mode == "live" and not self._lasts:
            early_ns = run.loaded_ns - reported.stamp_ns
            if early_ns > seconds_to_ns(limits.REPORT_AGE_S):
                text = f"not counted, since it is from before the load: {reported.text}"
                self.outbox.append(outbox.Note(now_ns, text))
                return
        self.fail(limits.in_session_time(reported, now_ns), announced=True)

    def fail(self, violation: limits.Violation, announced: bool = False) -> None:
        """Take a limit that was passed: announce it and abort. The first one gives the verdict.

        Args:
            violation: the limit.
            announced: another node saw it and has published its event already.
        """
        if self.state in (SessionPhase.IDLE, SessionPhase.FINISHED, SessionPhase.ABORTED):
            return
        heartbeat_s = self._run.spec.limits.heartbeat_s if self._run is not None else 0.0
        # A world that waits for us stands still with us: nothing is late in its time.
        late_s = 0.0 if self._is_awaited else self.late_s
        own = limits.own_lateness(violation, late_s, heartbeat_s)
        announced = announced and own is violation
        violation = own
        if self._run is not None and not self._run.blame(violation):
            return
        if not announced:
            self.outbox.append(violation)
        if self.state is not SessionPhase.ABORTING:
            self._move(SessionEvent.ABORT, violation.stamp_ns, violation.text)

    def name_strangers(self, texts: Iterable[str], now_ns: int) -> None:
        """Name what ended the session, where its reason has no name for it yet."""
        run = self._run
        if run is None or self.state is not SessionPhase.ABORTING:
            return
        if not any(reason.startswith(_FOREIGN) for reason in run.verdict.reasons):
            return
        for text in texts:
            if NAMELESS not in text and not any(text in reason for reason in run.verdict.reasons):
                run.reason(Verdict.INVALID_HARNESS, text, now_ns)

    @property
    def _is_awaited(self) -> bool:
        """Tell whether a simulated world waits for our answer to each step."""
        in_steps = self.state in WATCHED and self.state is not SessionPhase.ARMED
        return in_steps and self._run is not None and self._run.spec.mode == "lockstep"

    def give_up_on_standstill(self, now_ns: int) -> None:
        """Report, once per abort, that no participant can confirm standstill.

        The session stays ABORTING, since what isn't known to stand may move.
        """
        run = self._run
        if run is None or self.state is not SessionPhase.ABORTING or self._standstill_given_up:
            return
        self._standstill_given_up = True
        who = preconditions.moving(
            run.spec,
            self.vut,
            self.targets,
            run.history.motion,
            now_ns,
            armed=run.armed,
            aborting=True,
        )
        text = f"not known to stand: {', '.join(who) or 'everything'}"
        self._tell(SessionPhase.ABORTING, STANDSTILL_GIVEN_UP, now_ns, text)

    def judge_triggers(
        self, now_ns: int, targets: Mapping[str, ObjectState] | None = None
    ) -> list[outbox.Outgoing]:
        """Evaluate all open triggers against the newest VUT state.

        The caller sends it at once, since it shall not wait for everything else that is looked at.
        ``step`` follows, and ends the run where a limit is passed: an object that has begun to
        brake takes no reference, and none takes effect before its execute_at.

        Triggers are judged before the phases, since every moment until their dispatch counts. A
        trigger that waits for a phase therefore fires with the state after the one that confirmed
        the phase.

        A state is not judged twice, nor when it is too old. Nor is it judged when it can't be
        believed: the step that follows then ends the run. A manoeuvre that can't be driven is
        remembered for that step too, since a limit that is passed at the same instant is the graver
        reason.

        Args:
            now_ns: session time, that of the dispatch; the stamp of the VUT's newest state is at
                most that.
            targets: newest states by id, including ones not yet taken in; None: ``self.targets``.
        """
        run, vut = self._run, self.vut
        targets = self.targets if targets is None else targets
        if run is None or vut is None or self.state is not SessionPhase.RUNNING:
            return []
        if run.triggers.has_evaluated(vut) or run.history.has_breaks or not vut.is_finite:
            return []
        return progress.judge_triggers(run, vut, targets, now_ns)

    def step(self, now_ns: int) -> None:
        """Judge the states of one instant: triggers, limits, phases, the end of the run.

        Args:
            now_ns: session time; the stamp of the VUT's newest state is at most that.
        """
        self.outbox += self.judge_triggers(now_ns)
        run = self._run
        if run is not None:
            self._judge(run, now_ns)
        if self.state is SessionPhase.ABORTING:
            self._forget_ahead(now_ns + seconds_to_ns(preconditions.FRESH_S))
        ending = self.state in (SessionPhase.STOPPING, SessionPhase.ABORTING)
        if ending and self.stands(now_ns):
            if self.state is SessionPhase.STOPPING and run:
                run.verdict.close()
            why = "everything stands" if run else "no run is loaded: what moves isn't known"
            self._move(SessionEvent.STANDSTILL, now_ns, why)

    # -- inside --------------------------------------------------------------------------------

    def _judge(self, run: Run, now_ns: int) -> None:
        if self.state in WATCHED:
            running = self.state is SessionPhase.RUNNING
            passed = progress.limits_passed(run, self.vut, self.targets, now_ns, running=running)
            self._take(passed)
        else:
            run.history.take_breaks()
        vut = self.vut
        if self.state is SessionPhase.RUNNING and vut is not None:
            if vut.stamp_ns > run.evaluated_ns:
                run.evaluated_ns = vut.stamp_ns
                if run.triggers.failed is not None:
                    self.fail(run.triggers.failed)
                if (began := run.event.judge(vut, self.targets)) is not None:
                    self._take([began])
                self._take(progress.watch_adaptation(run, vut, now_ns))
                run.event.note_contact(vut, self.targets)
            self._take(run.dispatches.send_again(now_ns))
            self._watch_end(run, now_ns)
        if self.state is SessionPhase.ABORTING:
            self._take(progress.collisions(run, vut, self.targets, now_ns))

    def _forget_ahead(self, latest_ns: int) -> None:
        """Forget states with a later stamp: a clock that was wrong must not outlast that."""
        if self.vut is not None and self.vut.stamp_ns > latest_ns:
            self.vut = None
        self.targets = {i: s for i, s in self.targets.items() if s.stamp_ns <= latest_ns}

    def _watch_end(self, run: Run, now_ns: int) -> None:
        if self.state is not SessionPhase.RUNNING:
            return
        if run.event.is_complete(now_ns, run.elapsed_s(now_ns)):
            over = "the event is resolved" if run.spec.driven is None else "the driven run is over"
            self._move(SessionEvent.COMPLETE, now_ns, over)
        elif (missing := progress.overdue(run, now_ns)) is not None:
            self.fail(missing)

    def _move(self, event: SessionEvent, now_ns: int, reason: str) -> None:
        """Make a transition and announce it. Raise IllegalTransition without effect."""
        previous = self.state
        self.state = next_state(previous, event)
        if event is SessionEvent.ABORT:
            # What was heard before says nothing of what came of it.
            self._senders.clear()
            self.aborts += 1
            self._standstill_given_up = False
        self._tell(previous, event.value, now_ns, reason)

    def _tell(self, previous: SessionPhase, event: str, now_ns: int, reason: str) -> None:
        change_fields = now_ns, self.state, previous, event, reason, self.verdict, self.reasons
        self.outbox.append(outbox.StateChanged(*change_fields))

    def _missing_for(self, event: SessionEvent, now_ns: int) -> list[str]:
        """List everything that a command lacks."""
        run, vut, targets = self._run, self.vut, self.targets
        if run is None:
            return []
        if event in _GATES:
            facts = replace(self.facts, motion=run.history.motion)
            obstacles = arming.obstacles(_GATES[event], run.spec, facts, vut, targets, now_ns)
            return [obstacle.text for obstacle in obstacles]
        if event is not SessionEvent.ALL_CLEAR:
            return []
        # What was heard before the abort is no proof.
        ids_with_state = {*targets, *([] if vut is None else [run.spec.vut.id])}
        motion, armed = run.history.motion, run.armed
        moving = partial(preconditions.moving, run.spec, vut, targets, motion, now_ns, armed=armed)
        unknown, unaware = set(moving()), set(moving(aborting=True))
        unknown |= ids_with_state - self._senders
        return [
            f"{i} is not known to stand" if i in unknown else f"{i} is armed: abort once more"
            for i in sorted(unknown | unaware)
        ]

    def _abort_by_operator(self, now_ns: int, requested_by: str, reason: str) -> None:
        text = f"abort by {requested_by}" + (f": {reason}" if reason else "")
        if self._run is not None:
            self._run.reason(Verdict.ABORTED, text, now_ns)
        violation = limits.Violation(SafetyCode.OPERATOR, "", 0.0, 0.0, now_ns, text)
        self.outbox.append(violation)
        self._move(SessionEvent.ABORT, now_ns, text)

    def _take(self, facts: Iterable[outbox.Outgoing]) -> None:
        """Send what was found, or end the run for it without sending the rest."""
        for fact in facts:
            if isinstance(fact, limits.Violation):
                self.fail(fact)
            elif self.state is SessionPhase.RUNNING:
                self.outbox.append(fact)

    def stands(self, now_ns: int, without: Sequence[str] = ()) -> bool:
        """Tell whether fresh states say that everything stands.

        A run that stops waits for the reason of an object that has aborted by itself: nothing that
        comes after the standstill counts.

        Args:
            now_ns: session time.
            without: objects that are not looked at, because they can't be heard.
        """
        run = self._run
        if self.state is SessionPhase.STOPPING and any(
            state.control_state is ControlState.ABORTING for state in self.targets.values()
        ):
            return False
        return run is None or not preconditions.moving(
            run.spec,
            self.vut,
            self.targets,
            run.history.motion,
            now_ns,
            armed=run.armed,
            aborting=self.state is SessionPhase.ABORTING,
            without=without,
        )
