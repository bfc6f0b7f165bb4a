"""Every number that scoring compares with, in one frozen object with a hash (METHOD 6.11)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, overload

from ssp_core.hashing import sha256_json
from ssp_vla_bridge.trajectory import SUPPORT_END_S, TOLERANCE_S

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Thresholds:
    """The thresholds and weights of METHOD 5.4 and 6.

    Args:
        tolerance: added to every inclusive comparison and to the equality of matching errors
            (6.11), in the unit of what is compared.
        match_window_s: largest distance of a matched record from its label (6.1).
        soft_credit: score of an adjacent class in the soft semantics (6.3).
        support_end_s: end of the interval that a trajectory must cover (5.4); it is sampled at
            its start, middle and end (6.6).
        stop_speed_mps: at or below it the trajectory stops (6.6).
        accel_mps2: size of an acceleration that counts as accelerate or decelerate (6.6).
        lateral_shift_m: size of a shift that counts as left or right (6.6).
        max_backward_m: how far a feasible step may go backwards (6.6).
        max_speed_mps: largest feasible speed (6.6).
        max_lateral_speed_mps: largest feasible lateral speed (6.6).
        max_accel_mps2: largest feasible size of the acceleration (6.6).
        response_count: K of 6.9, how many consecutive defensive candidates make a response.
        response_gap_s: largest gap between two of them (6.9).
        weight_jovr, weight_sem_acc_eff, weight_cia_eff, weight_tqsr, weight_rsr: of IVCS (6.10).
    """

    tolerance: float = TOLERANCE_S
    match_window_s: float = 0.11
    soft_credit: float = 0.5
    support_end_s: float = SUPPORT_END_S
    stop_speed_mps: float = 0.5
    accel_mps2: float = 0.5
    lateral_shift_m: float = 0.3
    max_backward_m: float = 0.2
    max_speed_mps: float = 25.0
    max_lateral_speed_mps: float = 5.0
    max_accel_mps2: float = 8.0
    response_count: int = 2
    response_gap_s: float = 0.6
    weight_jovr: float = 0.10
    weight_sem_acc_eff: float = 0.30
    weight_cia_eff: float = 0.20
    weight_tqsr: float = 0.30
    weight_rsr: float = 0.10

    @property
    def sha256(self) -> str:
        """``sha256:<hex>`` over all names and values; it is part of every result (METHOD 6.11)."""
        return _sha256(self)

    @overload
    def at_most(self, value: float, limit: float) -> bool: ...
    @overload
    def at_most(self, value: NDArray[np.float64], limit: float) -> NDArray[np.bool_]: ...
    def at_most(self, value: float | NDArray[np.float64], limit: float) -> bool | NDArray[np.bool_]:
        """value ≤ limit with the tolerance of METHOD 6.11; False for NaN."""
        return value <= limit + self.tolerance

    @overload
    def at_least(self, value: float, limit: float) -> bool: ...
    @overload
    def at_least(
        self, value: NDArray[np.float64], limit: float | NDArray[np.float64]
    ) -> NDArray[np.bool_]: ...
    def at_least(
        self, value: float | NDArray[np.float64], limit: float | NDArray[np.float64]
    ) -> bool | NDArray[np.bool_]:
        """value ≥ limit with the tolerance of METHOD 6.11; False for NaN."""
        return value >= limit - self.tolerance


@lru_cache(maxsize=64)
def _sha256(thresholds: Thresholds) -> str:
    return sha256_json(asdict(thresholds))


DEFAULT = Thresholds()
