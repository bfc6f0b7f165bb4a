"""The facts of tracking and braking that stand on the card of each driver."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS
from ssp_ot_controller.control.tracker import Tracker
from ssp_ot_controller.driving.pilot import ROUTE_M
from ssp_ot_controller.driving.plan import PLAN_LIMITS
from ssp_ot_controller.driving.questions import HISTORY_S


def driving_facts(vut_class: ObjectClass) -> dict[str, Any]:
    """Return what holds for every driver of a VUT of this class.

    ``d_max_mps2`` is the service deceleration of its body (METHOD 8.1).
    """
    return {
        "tracker": f"{Tracker.__module__}.{Tracker.__name__}, by time",
        "d_max_mps2": LIMITS[vut_class].deceleration_mps2,
        "route_m": ROUTE_M,
        "history_s": HISTORY_S,
        "plan_limits": asdict(PLAN_LIMITS),
    }
