"""The driving task that every model is asked: one definition, from which native prompts come."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS

_INSTRUCTION = (
    "You drive the vehicle from whose forward camera these frames come, oldest first. "
    "For the time of the last frame, say in plain English which road users matter, where the "
    "critical one is relative to your vehicle and how it moves, whether there is a conflict "
    "with it, and what your vehicle does now: its longitudinal and its lateral action. "
    "Then give the trajectory that your vehicle will follow."
)


@dataclass(frozen=True)
class DrivingTask:
    """What a model is to answer, independent of its native prompt (METHOD 5.1, 5.4).

    Args:
        instruction: for the model, plain English.
        objects: closed vocabulary of the objects slot.
        positions: closed vocabulary of the position slot.
        motions: closed vocabulary of the motion slot.
        conflicts: closed vocabulary of the conflict slot.
        lon_actions: allowed longitudinal actions.
        lat_actions: allowed lateral actions.
        trajectory_step_s: time between the points asked for, s.
        trajectory_horizon_s: time of the last point asked for, s after the request's time.
    """

    instruction: str
    objects: tuple[str, ...]
    positions: tuple[str, ...]
    motions: tuple[str, ...]
    conflicts: tuple[str, ...]
    lon_actions: tuple[str, ...]
    lat_actions: tuple[str, ...]
    trajectory_step_s: float
    trajectory_horizon_s: float


TASK = DrivingTask(
    instruction=_INSTRUCTION,
    objects=OBJECTS,
    positions=POSITIONS,
    motions=MOTIONS,
    conflicts=CONFLICTS,
    lon_actions=LON_ACTIONS,
    lat_actions=LAT_ACTIONS,
    trajectory_step_s=0.5,
    trajectory_horizon_s=2.0,
)
