"""Which tracker a parameter names."""

from __future__ import annotations

from typing import Literal

from ssp_core.vocab import ObjectClass
from ssp_ot_controller.core.bodies import BodyLimits
from ssp_ot_controller.core.tracking import Tracker


def make_tracker(
    kind: Literal["lqr", "mpc"],
    object_class: ObjectClass,
    limits: BodyLimits | None = None,
    dt_s: float = 0.02,
) -> Tracker:
    """A tracker of a kind; see core.tracking and core.mpc.

    Raises:
        HostError: mpc without the package that it needs.
        KeyError: a class without a body (UNKNOWN).
    """
    if kind == "mpc":
        # Only who asks for it waits for the sparse matrices of its problems.
        from ssp_ot_controller.core.mpc import MpcTracker

        return MpcTracker(object_class, limits, dt_s)
    return Tracker(object_class, limits, dt_s)
