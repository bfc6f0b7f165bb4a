"""Do the service brakes do what they are asked? If not, the emergency brake has to."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds

# From the first command to brake on the object is given so long before it is judged.
PATIENCE_S = 0.5
# After that it must have lost this share of the speed that the deceleration would have taken.
LEAST_SHARE = 0.5
# Below this speed brakes that judder at the end of a stop are no matter.
_SLOW_MPS = 0.3


@dataclass(frozen=True, slots=True)
class BrakeWatch:
    """When a braking began and at what speed."""

    since_ns: int
    from_mps: float

    def fails(self, speed_mps: float, now_ns: int, deceleration_mps2: float) -> bool:
        """True when the object is too fast for the time that it has been braking.

        Args:
            speed_mps: measured; no number counts as too fast.
            now_ns: on the clock of ``since_ns``.
            deceleration_mps2: that was asked for all the time.
        """
        elapsed_s = ns_to_seconds(now_ns - self.since_ns)
        if elapsed_s < PATIENCE_S:
            return False
        due_mps = abs(self.from_mps) - LEAST_SHARE * deceleration_mps2 * elapsed_s
        return not abs(speed_mps) <= max(due_mps, _SLOW_MPS)
