"""An ISO 22133 object on a straight trajectory, and how far it goes until it stands."""

from __future__ import annotations

from typing import Any

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.safety.stopping import stopping_of
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.rehearsal.iso_object import STEP_S
from tests.support.iso22133.centre import Centre, played_object, rules_of, trajectory, way_m

STRAIGHT = drive_along(Polyline([(0.0, 0.0), (200.0, 0.0)]), 0.0, 0.0, 8.0, 2.0, 2.0)
TRAJ = trajectory(STRAIGHT)


def driving(for_s: float = 6.0, **limits: Any) -> Centre:
    return Centre(played_object(**limits)).driving(TRAJ, for_s)


def stop_way_m(centre: Centre, for_s: float = 8.0) -> float:
    """Return the way that the object drives until it stands."""
    since = centre.played.body
    centre.run(for_s, until=lambda: centre.played.body.speed_mps == 0.0)
    assert centre.played.body.speed_mps == 0.0
    return way_m(since, centre.played.body)


def bound_m(centre: Centre, blind_s: float) -> float:
    """The stopping distance that our objects state, after so long without a sign."""
    stopping = stopping_of(ObjectClass.CAR, rules_of().limits, STEP_S)
    return stopping.distance_m(centre.played.body.speed_mps, blind_s)
