"""Faults that the runner injects: those of processes, of the operator, and strange references.

Object-side faults (links, localisation, actuators, the VUT) are injected where they happen, by the
simulated world and the object targets. What is begun and ended here is published on
``fault_event`` and kept for ``faults.json``, since the recorder may be what was struck.
"""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ssp_core import names
from ssp_core.errors import InputError
from ssp_core.host.processes import NodeProcess, ProcessGroup
from ssp_core.run_file.model import Fault, RunSpec

if TYPE_CHECKING:  # a run in one process needs no ROS
    from ssp_scenario_manager.ros.fault_injector import FaultEndpoints

FAULTS_FILE = "faults.json"
WITNESS_FILE = "witness.json"
_OF_NODES = ("kill", "pause", "disk_full")
_OF_REFERENCES = ("reference_stale", "reference_out_of_fence")
# Longer than any approach passes by, and short enough that a loaded run may still hope for it.
_HELD_SHARE = 0.7
# The world's clock has come to stand when nothing newer was heard for so long; one that goes on for
# longer than the second isn't struck by the signal.
_STANDS_S = 0.3
_SETTLES_S = 1.0
# The world goes on without a participant in lockstep after so long, on the wall's clock, at the
# earliest (HANG_LIMIT_S of ssp_ot_controller.sil.patience).
WORLD_WAITS_S = 3.0
# How long an armed session is held with a fault in it, for the limits that apply to it.
ARMED_HOLD_S = 3.0
NEED_PROCESSES = frozenset((*_OF_NODES, *_OF_REFERENCES))
RUNNER_KINDS = NEED_PROCESSES | {"operator_abort", "trigger_never"}


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """The begin or end of a fault.

    Args:
        index: of the fault in the run file.
        active: True: it begins.
        session_s: session time at that instant as far as the runner knew it, to the µs; 0 before
            the start. What stops the simulated world is dated by where its clock came to stand.
        wall_s: steady time since the runner started, to the µs.
    """

    index: int
    kind: str
    target: str
    active: bool
    session_s: float
    wall_s: float


@dataclass
class _TimedFault:
    index: int
    fault: Fault
    begun_s: float | None = None
    heard: tuple[float, float] | None = None
    """Newest session time and when it was heard, while the world's clock may still go on."""
    looked_s: float = 0.0
    """When it was last looked at, while that is awaited."""
    ended: bool = False

    def is_over(self, wall_s: float) -> bool:
        """Tell whether it is over, by the wall clock, since a paused world stops its own."""
        duration_s = self.fault.duration_s
        if self.begun_s is None or self.ended or duration_s is None:
            return False
        return wall_s - self.begun_s >= duration_s


def of_runner(spec: RunSpec) -> list[tuple[int, Fault]]:
    """Return the faults of a run that are injected here, with their index in the run file."""
    return [(i, fault) for i, fault in enumerate(spec.faults) if fault.kind in RUNNER_KINDS]


def strikes_armed(spec: RunSpec) -> bool:
    """Tell whether any fault strikes the armed session before its start."""
    return any(fault.at_s is None for fault in spec.faults)


def check(spec: RunSpec, nodes: Iterable[str]) -> None:
    """Refuse faults of the runner that strike nothing.

    Raises:
        InputError: a target that is no node or object of this run, an end where there is none.
    """
    running, objects = list(nodes), [t.id for t in spec.targets]
    for index, fault in of_runner(spec):
        if fault.kind in _OF_NODES:
            choices, what = running, "node"
            if fault.kind == "disk_full":
                choices = [names.MONITOR]
        elif fault.kind in _OF_REFERENCES:
            choices, what = objects, "object target"
        else:
            choices, what = [""], "target"
        if fault.target not in choices:
            raise InputError(
                f"is no {what} that {fault.kind} can strike in this run",
                field=f"faults[{index}].target",
                value=fault.target,
                remedy=f"choose {', '.join(choices)}" if choices != [""] else "leave it out",
            )
        if spec.mode == "live" and fault.kind in _OF_REFERENCES:
            raise InputError(
                f"{fault.kind} needs the simulated world",
                field=f"faults[{index}].kind",
                remedy="try it in lockstep or realtime",
            )
        if fault.duration_s is not None and fault.kind != "pause":
            raise InputError(
                f"means nothing for {fault.kind}, which has no end",
                field=f"faults[{index}].duration_s",
                value=fault.duration_s,
                remedy="leave it out",
            )


def with_conditions_never_met(spec: RunSpec) -> RunSpec:
    """Return the run with triggers whose conditions would have to hold for most of its time.

    It stands for a condition that doesn't come true on the day; such a run may start, and must end
    by itself. A run without a ``trigger_never`` fault is returned as it is.
    """
    if not any(fault.kind == "trigger_never" for fault in spec.faults):
        return spec
    held_s = _HELD_SHARE * min(spec.end.at_latest_s, spec.limits.duration_s)
    triggers = [t.model_copy(update={"held_for_s": held_s}) for t in spec.triggers]
    return spec.model_copy(update={"triggers": triggers})


@dataclass
class FaultInjector:
    """Begins and ends the runner's faults when their time has come."""

    spec: RunSpec
    group: ProcessGroup
    bag: Path
    hands: FaultEndpoints
    say: Callable[[str], None]
    injected: list[InjectedFault] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._timed = [_TimedFault(index, fault) for index, fault in of_runner(self.spec)]

    def strike_armed(self, wall_s: float) -> None:
        """Begin the faults that strike before the start; the session is armed and holds."""
        for timed in self._timed:
            if timed.fault.at_s is None and timed.begun_s is None:
                self._begin(timed, 0.0, wall_s)

    def poll(self, session_s: float, wall_s: float) -> None:
        """Begin and end what is due.

        Args:
            session_s: session time of the run, 0 before it starts.
            wall_s: steady time since the runner started, s.
        """
        for timed in self._timed:
            at_s = timed.fault.at_s
            if timed.begun_s is None:
                if at_s is not None and session_s > 0.0 and session_s >= at_s:
                    self._begin(timed, session_s, wall_s)
                continue
            if timed.heard is not None:
                self._settle(timed, session_s, wall_s)
            elif self._stops_the_world(timed.fault) and wall_s - timed.begun_s < WORLD_WAITS_S:
                self._date_anew(timed, session_s)
            if timed.is_over(wall_s):
                self._end(timed, session_s, wall_s)

    def release(self, session_s: float, wall_s: float) -> bool:
        """End all lasting faults that can be ended, so that the processes can stop in order.

        Returns:
            True when a node goes on now that stood still, and that wasn't ended meanwhile.
        """
        lasting = [t for t in self._timed if t.begun_s is not None and not t.ended]
        for timed in lasting:
            self._end(timed, session_s, wall_s)
        return any(
            timed.fault.kind == "pause" and self._process(timed.fault.target).returncode is None
            for timed in lasting
        )

    # -- what is done ----------------------------------------------------------------------------

    def _begin(self, timed: _TimedFault, session_s: float, wall_s: float) -> None:
        fault = timed.fault
        timed.begun_s = wall_s
        if self._stops_the_world(fault):
            # In lockstep the world may be far ahead of what this process has heard of it.
            timed.heard, timed.looked_s = (session_s, wall_s), wall_s
        else:
            self._note(timed, True, session_s, wall_s)
        if fault.kind == "kill":
            self._signal(fault.target, signal.SIGKILL)
        elif fault.kind == "pause":
            self._signal(fault.target, signal.SIGSTOP)
        elif fault.kind == "disk_full":
            self._limit_files(fault.target)
        elif fault.kind == "operator_abort":
            self.hands.abort(f"fault {timed.index} of the run file")
        elif fault.kind in _OF_REFERENCES:
            self.hands.send_strange_reference(fault.target, fault.kind)

    def _stops_the_world(self, fault: Fault) -> bool:
        """Tell whether a fault stops the world's clock at once, since it waits for participants."""
        struck = fault.kind in ("kill", "pause") and fault.target != names.MONITOR
        return struck and self.spec.mode == "lockstep" and fault.at_s is not None

    def _settle(self, timed: _TimedFault, session_s: float, wall_s: float) -> None:
        """Note the beginning once the session's time stands."""
        newest_s, heard_s = timed.heard or (session_s, wall_s)
        begun_s = heard_s if timed.begun_s is None else timed.begun_s
        waited_s, timed.looked_s = wall_s - timed.looked_s, wall_s
        if session_s == newest_s and waited_s >= _STANDS_S:
            # This process itself was kept waiting, and may not have heard what is there.
            timed.heard = (session_s, wall_s)
            return
        if session_s == newest_s and wall_s - heard_s < _STANDS_S:
            return
        if session_s == newest_s or wall_s - begun_s > _SETTLES_S:
            timed.heard = None
            self._note(timed, True, session_s, begun_s)
        else:
            timed.heard = (session_s, wall_s)

    def _end(self, timed: _TimedFault, session_s: float, wall_s: float) -> None:
        timed.ended = True
        if timed.heard is not None:
            timed.heard = None
            self._note(timed, True, session_s, timed.begun_s or wall_s)
        if timed.fault.kind == "pause":
            # A world goes on without another participant that has been silent for too long.
            if timed.fault.target == names.SIL_WORLD and self.spec.mode == "lockstep":
                self._date_anew(timed, session_s)
            self._signal(timed.fault.target, signal.SIGCONT)
            self._note(timed, False, session_s, wall_s)

    def _date_anew(self, timed: _TimedFault, session_s: float) -> None:
        """Set the beginning to the newest time that was heard while the world's clock stood.

        A clock that stands doesn't go on: what came after the beginning was noted came late.
        """
        for number, one in enumerate(self.injected):
            if one.index == timed.index and one.active and session_s > one.session_s:
                self.injected[number] = replace(one, session_s=round(session_s, 6))

    def _note(self, timed: _TimedFault, active: bool, session_s: float, wall_s: float) -> None:
        fault = timed.fault
        who = f" of {fault.target}" if fault.target else ""
        at = f"{session_s:.2f} s" if fault.at_s is not None else "armed, before the start"
        self.say(f"FAULT {fault.kind}{who} {'begins' if active else 'ends'} ({at})")
        value = fault.value if fault.value is not None else float("nan")
        self.hands.tell_fault(f"{timed.index} {fault.kind}", fault.target, active, value)
        times = round(session_s, 6), round(wall_s, 6)
        self.injected.append(InjectedFault(timed.index, fault.kind, fault.target, active, *times))

    def _signal(self, node: str, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            os.kill(self._process(node).process.pid, number)

    def _limit_files(self, node: str) -> None:
        """Limit the process's files to the bag's present size: writing it now fails.

        It stands for a full disk or a used-up quota: the recorder's next write raises OSError, as
        it would with ENOSPC; only the number differs (EFBIG).
        """
        sizes = [file.stat().st_size for file in self.bag.glob("*.mcap")]
        with suppress(ProcessLookupError):
            pid = self._process(node).process.pid
            _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (max(sizes, default=0), hard))

    def _process(self, node: str) -> NodeProcess:
        return self.group.processes[node]
