"""Who was heard when, on the steady clock, and whose silence ends a session."""

from __future__ import annotations

import math

from ssp_core import names
from ssp_core.clock import ns_to_seconds
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_scenario_manager.core import supervisor
from ssp_scenario_manager.core.link_clock import LinkClocks
from ssp_scenario_manager.core.readiness import Facts
from ssp_scenario_manager.core.supervisor import Violation, of_object, silent

# A simulated world that is silent this long is taken for dead. In lockstep it may wait for a
# participant that died before it drops it, so that its silence means less.
WORLD_SILENT_LOCKSTEP_S = 4.0
WORLD_SILENT_REALTIME_S = 0.5
# A world that died must be named before the vehicle that it moved.
_AFTER_WORLD_S = 0.25
RECORDER_SILENT_S = 2.0
CAMERA_SILENT_S = 3.0


class Vigil:
    """Last sign of life of each participant. Reads no clock: times are given, in ns.

    Args:
        links: the answers to heartbeats.
    """

    def __init__(self, links: LinkClocks | None = None) -> None:
        self.links = links or LinkClocks()
        self.recorder_ready = False
        self.recorder_missing: tuple[str, ...] = ()
        self.recorder_lost = 0
        # By topic that one node alone may publish: how many others do, and who.
        self.foreign: dict[str, tuple[int, str]] = {}
        self._heard_ns: dict[str, int] = {}

    def hear(self, who: str, steady_ns: int) -> None:
        self._heard_ns[who] = steady_ns

    def hear_recorder(
        self, ready: bool, missing: tuple[str, ...], lost: int, steady_ns: int
    ) -> None:
        """What the recorder says of itself (RecorderStatus.msg)."""
        self.hear(names.MONITOR, steady_ns)
        self.recorder_ready, self.recorder_missing, self.recorder_lost = ready, missing, lost

    @property
    def other_managers(self) -> int:
        return sum(count for count, _ in self.foreign.values())

    @property
    def foreign_text(self) -> str:
        return "; ".join(text for _, text in self.foreign.values())

    def age_s(self, who: str, steady_ns: int) -> float:
        """Seconds since the last sign of life, inf before the first."""
        heard = self._heard_ns.get(who)
        return math.inf if heard is None else ns_to_seconds(steady_ns - heard)

    def facts(self, spec: RunSpec | None, steady_ns: int) -> Facts:
        """What readiness asks for beside the states."""
        ids = [target.id for target in spec.targets] if spec else []
        return Facts(
            recorder_ready=self.recorder_ready,
            recorder_missing=self.recorder_missing,
            recorder_lost=self.recorder_lost,
            recorder_age_s=self.age_s(names.MONITOR, steady_ns),
            camera_age_s=self.age_s(names.FRONT_CAMERA, steady_ns),
            vut_age_s=self.age_s(names.VUT_ID, steady_ns),
            target_age_s=tuple((i, self.age_s(i, steady_ns)) for i in ids),
            links=tuple((i, self.links.link(i, steady_ns)) for i in ids),
            other_managers=self.other_managers,
            foreign=self.foreign_text,
        )

    def violations(
        self, spec: RunSpec, phase: SessionPhase, steady_ns: int, stamp_ns: int
    ) -> list[Violation]:
        """Everybody whose silence has lasted too long, whose link is too bad, or who is too many.

        In lockstep, what a run is judged by counts simulated time, so that here are only those
        whose death stops that time, and before the run everybody.

        Args:
            spec: the run; says its mode, and whether there is a camera.
            phase: of the session: ARMED, RUNNING or STOPPING.
            steady_ns: now, on the clock of ``hear``.
            stamp_ns: session time, for the events.
        """
        lockstep = spec.mode == "lockstep"
        world_s = WORLD_SILENT_LOCKSTEP_S if lockstep else WORLD_SILENT_REALTIME_S
        # The age of states is judged by their stamps; this is for stamps that can't be believed.
        state_s = max(world_s, spec.limits.state_age_s)
        if spec.mode == "live":
            watched = [(SafetyCode.VUT_SILENT, names.VUT_ID, state_s)]
        else:
            watched = [
                (SafetyCode.WORLD_SILENT, names.SIL_WORLD, world_s),
                (SafetyCode.VUT_SILENT, names.VUT_ID, state_s + _AFTER_WORLD_S),
            ]
        if not lockstep or phase is SessionPhase.ARMED:
            watched += [(SafetyCode.OBJECT_SILENT, t.id, state_s) for t in spec.targets]
        watched.append((SafetyCode.RECORDER, names.MONITOR, RECORDER_SILENT_S))
        if spec.camera is not None:
            watched.append((SafetyCode.PARTICIPANT_LOST, names.FRONT_CAMERA, CAMERA_SILENT_S))
        found = [
            silent(code, who, self.age_s(who, steady_ns), limit_s, stamp_ns)
            for code, who, limit_s in watched
        ]
        found.append(supervisor.recorder_lost(self.recorder_lost, stamp_ns))
        found.append(supervisor.foreign_manager(self.other_managers, stamp_ns, self.foreign_text))
        if not lockstep:
            for target in spec.targets:
                found += self._of_link(spec, target.id, steady_ns, stamp_ns)
        return [violation for violation in found if violation is not None]

    def _of_link(
        self, spec: RunSpec, object_id: str, steady_ns: int, stamp_ns: int
    ) -> list[Violation | None]:
        """What the answers to heartbeats say; a link that isn't measured is silent by its age."""
        link, limits = self.links.link(object_id, steady_ns), spec.limits
        found = [supervisor.reply_missing(object_id, link.age_s, limits, stamp_ns)]
        if math.isfinite(link.delay_s):
            offset = judge.clock_offset(link.offset_s, limits)
            delay = judge.link_delay(link.delay_s, limits)
            how = "measured by heartbeats"
            found += [of_object(passed, object_id, stamp_ns, how) for passed in (offset, delay)]
        return found
