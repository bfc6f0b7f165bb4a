"""Follows one session from its goal to its end: processes, signals, injected faults."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.clock import seconds_to_ns
from ssp_core.host.processes import NodeProcess, ProcessGroup
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.liveness import WORLD_SILENT_LOCKSTEP_S
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import sees_frames
from ssp_scenario_manager.ros.fault_injector import FaultEndpoints
from ssp_scenario_manager.ros.runner_client import RunClient, StepwiseClient
from ssp_scenario_manager.ros.start_listener import StartListener
from ssp_scenario_manager.run import faults
from ssp_scenario_manager.run.over_dds.live import LiveSetup
from ssp_scenario_manager.run.over_dds.processor_waits import (
    ProcessorWaits,
    waited_ns,
    with_busy_machine,
)
from ssp_scenario_manager.run.over_dds.summary import PROMPT, PromptFacts, connected, summary
from ssp_scenario_manager.run.over_dds.word import ABORT, HOLDS_S, TypedWords, Word
from ssp_scenario_manager.session.run_script import RunOutcome

# Seven processes start at once, which a busy host may delay.
START_TIMEOUT_S = 90.0
# After a process died, or a person asked for the end, an abort is under way within this time, or
# the run is ended. A world in lockstep may wait for half of it for who died.
END_TIMEOUT_S = 20.0
# Objects that hear no manager any more, or a world that goes on after a pause: time to stand.
STANDSTILL_S = 30.0
# A session doesn't begin before its camera can draw. The first start in a checkout compiles the
# kernels: some 20 s on a quiet machine, two minutes seen where seven others were at work.
SLOW_START_S = 300.0
SLOW_START_TOLD_S = 5.0
# A model's process is given up after ten minutes, by the node that waits for it.
MODEL_START_S = 630.0
FIRST_START = "its first start in a checkout compiles the camera's kernels (once, about 20 s)"
# Beyond the heartbeat's limit, for an object to say on the wall's clock that it was passed.
NOTICED_S = 0.5
# A truth this old comes from a world that is dead or stands still, and so does all in it. One in
# lockstep that lives may still wait for who died; WORLD_SILENT_LOCKSTEP_S is its limit.
WORLD_GONE_S = 2.0
# The manager tells of itself every second; objects stop long before. A busy host may delay it.
SILENT_S = 10.0
# A live network tells of the managers in it within this time.
SETTLE_S = 1.5
# A publisher of a process that has ended is gone from discovery by then.
OTHERS_S = 25.0
OTHERS = "more than one manager is reached from here"
ABORT_ONLY = f'only "{ABORT}" counts now'
# The summary above the prompt waits so long for everybody to be connected.
LOOK_S = 8.0
# And so long for what keeps objects from being armed, of which other drivers than ours say nothing.
BODIES_TOLD_S = 1.5
# From the first sign of an abort to the session's result. The manager gives up waiting for a
# standstill before; whatever keeps it from that, the run has a verdict within half a minute.
RESULT_S = 25.0
# With the objects' standstill after it, where nobody leads them any more.
VERDICT_S = 28.0
# For what a session that has given its result, or gives up, still has to say.
LAST_WORDS_S = 8.0


Mark = Callable[[], Callable[[], bool]]


@dataclass(slots=True)
class Interrupt:
    """The requests to end the run: their number, and the signal of the first.

    Args:
        count: how many came.
        first: the name of the first signal.
        may_stand_still: nothing is led that moves, so that the terminal may suspend this process.
    """

    count: int = 0
    first: str = ""
    may_stand_still: bool = True

    def on_signal(self, number: signal.Signals) -> None:
        """Take a signal, as a handler for on_stop_signals."""
        self.count += 1
        self.first = self.first or number.name

    def on_suspension(self) -> bool:
        """Take the terminal's Ctrl-Z, as a handler for on_suspension; True: it ends the run.

        In a process that stands still neither terminal nor signal can abort.
        """
        if self.may_stand_still:
            return False
        if not self.count:
            self.on_signal(signal.SIGTSTP)
        return True


@dataclass(frozen=True, slots=True)
class SessionOutcome:
    """The outcome of a session.

    Args:
        session_s: session time that passed.
        running_wall_s: wall time that it took.
        faults: what was injected and heard, empty without faults (``faults.json``).
        witness: truth as the runner heard it, empty without faults (``witness.json``).
    """

    outcome: RunOutcome
    session_s: float = 0.0
    running_wall_s: float = 0.0
    faults: dict[str, Any] = field(default_factory=dict)
    witness: dict[str, Any] = field(default_factory=dict)


def follow(
    spec: RunSpec,
    group: ProcessGroup,
    run_file: Path,
    bag: Path,
    say: Callable[[str], None],
    interrupt: Interrupt,
    live: LiveSetup | None = None,
    mark: Mark = lambda: lambda: True,
) -> SessionOutcome:
    """Wait for the manager, have the run done, and watch processes and signals meanwhile.

    Args:
        spec: the run.
        group: the session's processes; the client leaves the domain after all of them have ended.
        run_file: that the manager loads.
        bag: that the recorder writes.
        say: tells the user a sentence; waits for nothing, or no abort would be heard meanwhile.
        interrupt: counts what the user asks for.
        live: options of a live session, which begins on a person's word by default; None:
            simulated.
        mark: returns a function that tells whether all that was said until now can be read.
    """
    remappings = live.remappings if live is not None else ()
    client = RunClient(group.env, say, spec, remappings)
    group.after_end.callback(client.close)
    following = _Following(spec, group, client, bag, say, interrupt, live, mark)
    return following.until_the_end(run_file)


class _Following:
    def __init__(
        self,
        spec: RunSpec,
        group: ProcessGroup,
        client: RunClient,
        bag: Path,
        say: Callable[[str], None],
        interrupt: Interrupt,
        live: LiveSetup | None,
        mark: Mark,
    ) -> None:
        self._spec = spec
        self._mark = mark
        self._live = live
        self._words = TypedWords() if live is not None else None
        self._group = group
        self._client = client
        self._say = say
        self._interrupt = interrupt
        self._ended_nodes: set[str] = set()
        self._hands: FaultEndpoints | None = None
        self._injector: faults.FaultInjector | None = None
        self._by_hand: StepwiseClient | None = None
        self._armed_at: float | None = None
        self._waits = ProcessorWaits()
        if spec.faults:
            self._hands = FaultEndpoints(client.node, spec, time.monotonic())
            self._injector = faults.FaultInjector(spec, group, bag, self._hands, say)

    def until_the_end(self, run_file: Path) -> SessionOutcome:
        if faults.strikes_armed(self._spec):
            self._by_hand = StepwiseClient(self._client.node, self._spec, str(run_file))
        failure = (
            self._wait_for_manager()
            or self._wait_for_camera()
            or self._wait_for_plant()
            or self._wait_for_driver()
            or self._wait_for_others_to_go()
        )
        if failure is not None:
            return SessionOutcome(failure)
        outcome = None
        while outcome is None:
            not_after_ns = 0
            if self._live is not None and not self._live.start_at_once:
                word = self._wait_for_word(run_file, self._live)
                if isinstance(word, RunOutcome):
                    return SessionOutcome(word)
                not_after_ns = word
            self._interrupt.may_stand_still = self._live is None
            if self._client.under_way:
                # Led from elsewhere.
                self._by_hand = None
            elif self._by_hand is not None:
                self._by_hand.begin(not_after_ns)
            else:
                self._client.begin(str(run_file), not_after_ns)
            outcome = self._wait()
            self._interrupt.may_stand_still = True
        return self._followed(outcome)

    def _wait_for_manager(self) -> RunOutcome | None:
        """Wait until the manager answers and return None; otherwise return why there is no run."""
        deadline = time.monotonic() + START_TIMEOUT_S
        parts = [part for part in (self._client, self._hands, self._by_hand) if part is not None]
        while missing := [one for part in parts for one in part.lacks()]:
            self._client.spin(0.05)
            if (failure := self._failed_before("did not come up: ")) is not None:
                return failure
            if time.monotonic() > deadline:
                server = os.environ.get("ROS_DISCOVERY_SERVER")
                what = f"{START_TIMEOUT_S:g} s (still missing: {', '.join(missing)})"
                reason = f"the scenario manager did not answer within {what}; " + (
                    f"does ROS_DISCOVERY_SERVER={server} answer? No node finds another without it"
                    if server
                    else "`ssp doctor` tests whether processes can talk on this host"
                )
                return RunOutcome(Verdict.INVALID_HARNESS, (reason,))
        self._client.hear_manager()
        return None

    def _wait_for_camera(self) -> RunOutcome | None:
        """Wait until the simulated camera can draw and return None; otherwise why there is no run.

        Before the goal is sent, whose steps have less time than compiling may take.
        """
        if names.FRONT_CAMERA not in self._group.processes:
            return None
        who, is_there = names.FRONT_CAMERA, self._client.camera_is_there
        return self._wait_for(is_there, f"{who} could not draw", f"{who}; {FIRST_START}")

    def _wait_for_plant(self) -> RunOutcome | None:
        """Wait until CARLA's vehicles stand at their starts, as ``_wait_for_camera``."""
        if self._spec.plant == "bodies":
            return None
        text = "CARLA, which measures how its vehicles answer"
        is_there = self._client.plant_is_there
        return self._wait_for(is_there, f"{names.SIL_WORLD} has no vehicles", text)

    def _wait_for_driver(self) -> RunOutcome | None:
        """Wait until the model that drives is loaded, as ``_wait_for_camera``."""
        driven = self._spec.driven
        if driven is None or not sees_frames(driven.driver):
            return None
        is_there, text = self._client.driver_is_there, f"{driven.driver}, which is loaded"
        return self._wait_for(is_there, f"{driven.driver} isn't loaded", text, MODEL_START_S)

    def _wait_for(
        self, is_there: Callable[[], bool], lacks: str, what: str, limit_s: float = SLOW_START_S
    ) -> RunOutcome | None:
        began_s, is_announced = time.monotonic(), False
        while not is_there():
            self._client.spin(0.05)
            if (failure := self._failed_before("did not come up: ")) is not None:
                return failure
            waited_s = time.monotonic() - began_s
            if waited_s > limit_s:
                reason = f"{lacks} within {limit_s:g} s; waited for {what}"
                return RunOutcome(Verdict.INVALID_HARNESS, (reason,))
            if waited_s > SLOW_START_TOLD_S and not is_announced:
                is_announced = True
                self._say(f"waiting for {what}")
        return None

    def _failed_before(self, word: str = "") -> RunOutcome | None:
        """Return why there will be no run: a dead process, a hung manager, a person.

        None: nothing.
        """
        if ended := self._group.ended():
            return RunOutcome(Verdict.INVALID_HARNESS, (word + obituary(ended[0]),))
        # A manager that comes up isn't heard yet.
        if not word and (silent := self._silent_manager()):
            return RunOutcome(Verdict.INVALID_HARNESS, (silent,))
        if self._interrupt.count:
            return RunOutcome(Verdict.ABORTED, ("interrupted before the start",))
        if self._words is not None and self._words.aborts_unasked(time.monotonic_ns()):
            return RunOutcome(Verdict.ABORTED, (f"{ABORT} before the start",))
        return None

    def _silent_manager(self) -> str:
        """End a hung manager and return why it counts as hung; empty while it doesn't."""
        if self._client.silent_s < SILENT_S:
            return ""
        silent = f"{names.SCENARIO_MANAGER} silent for {self._client.silent_s:.0f} s"
        self._say(f"{silent}: ending the run without it")
        # It must not wake up beside objects that were told that the run is over.
        self._group.processes[names.SCENARIO_MANAGER].kill()
        return silent

    def _stuck_manager(self) -> str:
        """End a manager that doesn't come to its end and return why; empty while it has time."""
        trouble = self._client.session.trouble
        if trouble is None or time.monotonic() - trouble[0] < RESULT_S:
            return ""
        stuck = f"{names.SCENARIO_MANAGER} gave no result {RESULT_S:g} s after {trouble[1]}"
        self._say(f"{stuck}: ending the run without it")
        self._group.processes[names.SCENARIO_MANAGER].kill()
        return stuck

    def _wait_for_others_to_go(self) -> RunOutcome | None:
        """Wait until there is one manager and return None; otherwise return why there is no run.

        A publisher of a process that has ended is seen for some seconds more.
        """
        began_s, is_announced = time.monotonic(), False
        settle_s = SETTLE_S if self._live is not None else 0.0
        while True:
            self._client.spin(0.05)
            if (failure := self._failed_before()) is not None:
                return failure
            waited_s = time.monotonic() - began_s
            others = self._client.other_managers()
            if not others and waited_s >= settle_s:
                return None
            if others and not is_announced:
                is_announced = True
                self._say(f"{OTHERS}: {', '.join(others)}")
            if others and waited_s > OTHERS_S:
                code = SafetyCode.FOREIGN_MANAGER
                reason = (
                    f"{MEANINGS[code].limit_name}: {' and '.join(others)} send heartbeats; end the "
                    "other session, or give this one a ROS_DOMAIN_ID of its own"
                )
                return RunOutcome(Verdict.INVALID_HARNESS, (reason,))

    def _wait_for_word(self, run_file: Path, live: LiveSetup) -> RunOutcome | int:
        """Load the run and ask for the word.

        Returns:
            When the word runs out, ns on the system clock; 0: the run was begun from elsewhere; or
            why there is no run.
        """
        if self._client.loaded is None:
            self._client.load(str(run_file))
        while self._client.loaded is None:
            self._client.spin(0.05)
            if (failure := self._failed_before()) is not None:
                return failure
        if self._client.loaded:
            return RunOutcome(Verdict.INVALID_HARNESS, self._client.loaded)
        words = self._words or TypedWords()
        listener = StartListener(self._client.node, self._spec)
        try:
            word: Word | None = Word.OTHER
            prompt_facts = PromptFacts(self._spec, Facts())
            is_read, is_prompted = self._mark(), False
            while word is not Word.START:
                if word in (Word.ABORT, Word.END_OF_INPUT):
                    return RunOutcome(Verdict.ABORTED, (f"{word.value} before the start",))
                if word is Word.OTHER:
                    prompt_facts = self._show(listener, live)
                    is_read, is_prompted = self._mark(), False
                self._client.spin(0.05)
                for line in prompt_facts.news(listener.facts()):
                    self._say(line)
                if self._client.under_way:
                    self._say(
                        "started or aborted elsewhere, as on the page; this terminal only follows"
                    )
                    return 0
                if (failure := self._failed_before()) is not None:
                    return failure
                if not is_prompted:
                    # On a terminal that is stopped nobody can read what is connected.
                    word, is_prompted = None, is_read()
                    if is_prompted:
                        words.ask(time.monotonic_ns())
                        self._say(PROMPT)
                        is_read = self._mark()
                    continue
                word = words.poll(time.monotonic_ns())
                if word is Word.START and not is_read():
                    word = Word.OTHER
                if word is Word.START and (others := self._client.other_managers()):
                    self._say(f"{OTHERS}: {', '.join(others)}")
                    word = Word.OTHER
        finally:
            listener.close()
        # It holds from when it may have been typed.
        waited_ns = time.monotonic_ns() - words.typed_after_ns
        return time.time_ns() + seconds_to_ns(HOLDS_S) - waited_ns

    def _show(self, listener: StartListener, live: LiveSetup) -> PromptFacts:
        """Show what is connected, and what isn't for which reason, above the prompt."""
        began_s = time.monotonic()
        while (waited_s := time.monotonic() - began_s) < LOOK_S:
            is_complete = listener.knows_bodies or waited_s > BODIES_TOLD_S
            if is_complete and all(connected(self._spec, listener.facts()).values()):
                break
            self._client.spin(0.05)
        facts = listener.facts()
        for line in summary(self._spec, live, facts, listener.states, listener.participation):
            self._say(line)
        return PromptFacts(self._spec, facts)

    def _look_at_waits(self) -> None:
        processes = self._group.processes.values()
        waits_ns = {one.name: waited_ns(one.process.pid) for one in processes}
        self._waits.look(waits_ns, time.monotonic_ns())

    def _wait(self) -> RunOutcome | None:
        """Return the outcome of the run, None where it didn't start while its word held."""
        cancelled, typed = 0, False
        deadline: float | None = None
        noticed_by_s = math.inf  # that a process died
        outcome: RunOutcome | None = None
        while outcome is None:
            self._client.spin(0.05)
            self._look_at_waits()
            self._inject()
            leads = self._client if self._by_hand is None else self._by_hand
            if (missing := leads.not_in_time) is not None and not self._ended_nodes:
                self._say(f"not started within {HOLDS_S:g} s: {'; '.join(missing)}")
                self._disarm()
                self._client.ask_again()
                return None
            outcome = self._client.outcome or self._cannot_start()
            for node in self._group.ended():
                if node.name not in self._ended_nodes:
                    self._ended_nodes.add(node.name)
                    self._say(f"{node.name} {node.describe_exit()}")
                    noticed_by_s = time.monotonic() + END_TIMEOUT_S
            silent = self._silent_manager() or self._stuck_manager() if outcome is None else ""
            if silent:
                outcome = RunOutcome(Verdict.INVALID_HARNESS, (silent,))
            if silent or names.SCENARIO_MANAGER in self._ended_nodes:
                # Nobody is left to give a result; the objects stop by themselves.
                self._let_objects_stop(VERDICT_S - self._unled_s())
                break
            if self._ended_nodes and not self._client.session.was_armed:
                # Nothing was armed: there is nothing that has to come to stand.
                self._client.cancel()
                break
            word = self._words.poll(time.monotonic_ns()) if self._words and not typed else None
            if word is Word.ABORT:
                typed = True
                self._say(f"{ABORT} typed: aborting the session")
                self._client.cancel()
                deadline = time.monotonic() + END_TIMEOUT_S
            elif word is not None:
                self._say(ABORT_ONLY)
            if self._interrupt.count > cancelled:
                cancelled = self._interrupt.count
                if cancelled > 1:
                    return RunOutcome(Verdict.ABORTED, ("interrupted twice, ended at once",))
                self._say(f"interrupted by {self._interrupt.first}: aborting the session")
                self._client.cancel()
                deadline = time.monotonic() + END_TIMEOUT_S
            if deadline is not None and time.monotonic() > deadline:
                break
            # An abort that is under way has its own time for the result, and a reason.
            if self._client.session.trouble is None and time.monotonic() > noticed_by_s:
                break
        return self._explained(outcome or RunOutcome(Verdict.INVALID_HARNESS, ()), typed, cancelled)

    def _explained(self, outcome: RunOutcome, typed: bool, cancelled: int) -> RunOutcome:
        """Add to an outcome what the runner knows of it.

        Args:
            outcome: by the manager.
            typed: the word that aborts was typed.
            cancelled: number of signals that came.
        """
        if self._client.session.first_event is not None and not self._ended_nodes:
            busy = self._waits.too_busy(*self._client.session.first_event)
            outcome = with_busy_machine(outcome, busy)
        if typed:
            outcome = RunOutcome(outcome.verdict, (f"{ABORT} typed", *outcome.reasons))
        if cancelled:
            outcome = RunOutcome(
                outcome.verdict, (f"interrupted by {self._interrupt.first}", *outcome.reasons)
            )
        for name in sorted(self._ended_nodes):
            outcome = outcome.with_reason(
                Verdict.INVALID_HARNESS, obituary(self._group.processes[name])
            )
        if not outcome.reasons and not outcome.ok:
            outcome = RunOutcome(outcome.verdict, ("the session gave no result in time",))
        return outcome

    # -- faults ----------------------------------------------------------------------------------

    def _inject(self) -> None:
        """Drive a run that waits for faults, and begin and end what is due."""
        if self._hands is None or self._injector is None:
            return
        self._injector.poll(self._hands.session_s, self._hands.wall_s)
        if self._by_hand is None:
            return
        if self._by_hand.is_armed and self._armed_at is None:
            self._armed_at = time.monotonic()
            self._injector.strike_armed(self._hands.wall_s)
        is_hold_over = (
            self._armed_at is not None and time.monotonic() - self._armed_at >= faults.ARMED_HOLD_S
        )
        self._by_hand.drive(may_start=is_hold_over)

    def _cannot_start(self) -> RunOutcome | None:
        if self._by_hand is None or not self._by_hand.problems:
            return None
        problems = self._by_hand.problems
        self._disarm()
        return RunOutcome(Verdict.INVALID_HARNESS, problems)

    def _disarm(self) -> None:
        """Disarm a session that is led step by step; it may be armed once more."""
        self._armed_at = None
        deadline = time.monotonic() + LAST_WORDS_S
        while self._by_hand and self._by_hand.stays_armed and time.monotonic() < deadline:
            self._by_hand.give_up()
            self._client.spin(0.05)

    def _hear_the_end(self, hands: FaultEndpoints, *, session: bool) -> None:
        """Take messages still on their way: ticks until all stand, and the session's last word."""
        deadline = time.monotonic() + LAST_WORDS_S
        while time.monotonic() < deadline:
            if hands.all_stand() and (hands.is_over or not session):
                return
            self._client.spin(0.05)

    def _unled_s(self) -> float:
        """Return the time since the manager was heard last, or trouble began."""
        trouble = self._client.session.trouble
        since_s = 0.0 if trouble is None else time.monotonic() - trouble[0]
        return max(self._client.silent_s, since_s)

    def _let_objects_stop(self, limit_s: float = STANDSTILL_S) -> None:
        """Give objects without a leader the time to notice it, and to come to a standstill."""
        hands = self._hands or FaultEndpoints(self._client.node, self._spec, time.monotonic())
        began_s = hands.wall_s
        until_s = self._spec.limits.heartbeat_s + NOTICED_S
        while hands.wall_s - began_s < limit_s:
            self._client.spin(0.1)
            heard_s = hands.newest_truth_s()
            waited_s = hands.wall_s - began_s
            if waited_s > until_s and (heard_s or 0.0) > began_s and hands.all_stand():
                return
            if hands.wall_s - max(heard_s or began_s, began_s) > self._world_gone_s():
                return

    def _world_gone_s(self) -> float:
        """Return the age of the newest truth at which the world counts as gone, s."""
        world = self._group.processes.get(names.SIL_WORLD)
        lives = world is not None and world.returncode is None
        waits = lives and self._spec.mode == "lockstep"
        return WORLD_SILENT_LOCKSTEP_S if waits else WORLD_GONE_S

    def _followed(self, outcome: RunOutcome) -> SessionOutcome:
        client, hands, injector = self._client, self._hands, self._injector
        if hands is None or injector is None:
            return SessionOutcome(
                outcome, client.session.times.session_s, client.session.times.wall_s
            )
        goes_on = injector.release(hands.session_s, hands.wall_s)
        if goes_on:
            # It goes on where it stood still; what was on its way there is seen now.
            self._let_objects_stop()
        self._hear_the_end(hands, session=goes_on)
        for index, fault in enumerate(self._spec.faults):
            if fault.at_s is not None and hands.session_s < fault.at_s:
                who = f" of {fault.target}" if fault.target else ""
                self._say(
                    f"fault {index}, {fault.kind}{who}, did not begin: the run ended before "
                    f"{fault.at_s:g} s"
                )
        faults = {
            "schema": "ssp.faults_injected/1",
            "injected": [asdict(one) for one in injector.injected],
            "heard": hands.runner_events,
        }
        return SessionOutcome(
            outcome, hands.session_s, client.session.times.wall_s, faults, hands.witness()
        )


def obituary(node: NodeProcess) -> str:
    """Describe how a process ended, with its last lines."""
    tail = node.log_tail(6)
    return f"{node.name} {node.describe_exit()}" + (f"; its last lines:\n{tail}" if tail else "")
