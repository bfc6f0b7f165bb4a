"""Who was heard when, on the steady clock, and whose silence ends a run."""

from __future__ import annotations

import math

from ssp_core import names
from ssp_core.clock import ns_to_seconds
from ssp_core.run_spec import RunSpec
from ssp_core.safety_codes import SafetyCode
from ssp_scenario_manager.core.supervisor import Violation, silent

# A simulated world that is silent this long is taken for dead. In lockstep it may wait for a
# participant that died before it drops it, so that its silence means less.
WORLD_SILENT_LOCKSTEP_S = 4.0
WORLD_SILENT_REALTIME_S = 0.5
RECORDER_SILENT_S = 2.0
CAMERA_SILENT_S = 3.0


class Vigil:
    """Last sign of life of each participant. Reads no clock: times are given, in ns."""

    def __init__(self) -> None:
        self._heard_ns: dict[str, int] = {}

    def hear(self, who: str, steady_ns: int) -> None:
        self._heard_ns[who] = steady_ns

    def age_s(self, who: str, steady_ns: int) -> float:
        """Seconds since the last sign of life, inf before the first."""
        heard = self._heard_ns.get(who)
        return math.inf if heard is None else ns_to_seconds(steady_ns - heard)

    def violations(
        self, spec: RunSpec, lockstep: bool, steady_ns: int, stamp_ns: int
    ) -> list[Violation]:
        """Everybody whose silence has lasted too long for a run.

        Args:
            spec: the run; says whether there is a camera.
            lockstep: the world waits for its participants.
            steady_ns: now, on the clock of ``hear``.
            stamp_ns: session time, for the events.
        """
        world_s = WORLD_SILENT_LOCKSTEP_S if lockstep else WORLD_SILENT_REALTIME_S
        watched = [
            (SafetyCode.WORLD_SILENT, names.SIL_WORLD, world_s),
            (SafetyCode.VUT_SILENT, names.VUT_ID, world_s),
            (SafetyCode.RECORDER, names.MONITOR, RECORDER_SILENT_S),
        ]
        if spec.camera is not None:
            watched.append((SafetyCode.PARTICIPANT_LOST, names.FRONT_CAMERA, CAMERA_SILENT_S))
        found = (
            silent(code, who, self.age_s(who, steady_ns), limit_s, stamp_ns)
            for code, who, limit_s in watched
        )
        return [violation for violation in found if violation is not None]
