"""Judgement whether an object obeys a command to stop."""

from __future__ import annotations

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_ot_controller.bodies.iso22133.messages import CentreStatus

# Slower than this an object counts as standing, and a loss of as much speed shows that it brakes.
SLOW_MPS = 0.3
# An object that has stood for so long has stopped: its crew may then drive it by hand.
_STOOD_NS = NS_PER_S


class StopWatch:
    """Judge of one command to stop, from the first heartbeat with it until the object has stood.

    Args:
        status: that the heartbeat carries: NORMAL_STOP or ABORT.
        speed_mps: reported when the command was first sent, without a sign.
        now_ns: when it was first sent.
        bound_s: from then on until the object must be slower.

    Attributes:
        slowed_s: from the command until the object had lost SLOW_MPS; None before.
    """

    def __init__(self, status: CentreStatus, speed_mps: float, now_ns: int, bound_s: float) -> None:
        self.status = status
        self.slowed_s: float | None = None
        self._from_mps = self._lowest_mps = speed_mps
        self._since_ns, self._bound_s = now_ns, bound_s
        # When it last drove, not before the bound is over.
        self._driven_ns = self._due_ns = now_ns + seconds_to_ns(bound_s)
        self._is_over = False

    def judge(self, speed_mps: float, now_ns: int) -> LimitViolation | None:
        """Judge the newest reported speed, without a sign.

        Returns:
            A violation where the object drives after the bound, and hasn't slowed by SLOW_MPS since
            the command, or is faster by more than that than it once was since.
        """
        took_s = ns_to_seconds(now_ns - self._since_ns)
        self._lowest_mps = min(self._lowest_mps, speed_mps)
        has_slowed = self._lowest_mps <= self._from_mps - SLOW_MPS
        if has_slowed and self.slowed_s is None:
            self.slowed_s = took_s
        if speed_mps > SLOW_MPS:
            self._driven_ns = max(now_ns, self._due_ns)
        self._is_over = self._is_over or now_ns - self._driven_ns >= _STOOD_NS
        obeys = has_slowed and speed_mps <= self._lowest_mps + SLOW_MPS
        if self._is_over or now_ns <= self._due_ns or speed_mps <= SLOW_MPS or obeys:
            return None
        return LimitViolation(
            SafetyCode.NOT_STOPPING,
            took_s,
            self._bound_s,
            f"drives {speed_mps:.1f} m/s {took_s:.2f} s after the command to "
            f"{self.status.name.lower().replace('_', ' ')}, and slows within {self._bound_s:g} s "
            "at most",
        )
