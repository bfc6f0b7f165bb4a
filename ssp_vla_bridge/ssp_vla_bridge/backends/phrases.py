"""Sentences and trajectories of the backends in this process."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_vla_bridge.adapters.points import WAYPOINTS_ARRAY, WAYPOINTS_FRAME
from ssp_vla_bridge.messages import DrivingTask, NativeArray

_NOUNS = {
    "car": "a car",
    "truck": "a truck",
    "bus": "a bus",
    "motorcycle": "a motorcycle",
    "cyclist": "a cyclist",
    "pedestrian": "a pedestrian",
}
_PLACES = {
    "front": "directly ahead of me",
    "front_left": "ahead on the left",
    "front_right": "ahead on the right",
    "left": "alongside on my left",
    "right": "alongside on my right",
    "rear": "behind me",
    "rear_left": "behind me on the left",
    "rear_right": "behind me on the right",
}
_MOTIONS = {
    "stationary": "is stationary",
    "same_direction": "is moving in the same direction as me",
    "oncoming": "is oncoming",
    "cutting_in_from_left": "is cutting in from the left",
    "cutting_in_from_right": "is cutting in from the right",
    "cutting_out": "is cutting out of my lane",
    "crossing_from_left": "is crossing from the left",
    "crossing_from_right": "is crossing from the right",
    "receding": "is pulling away from me",
}
_CONFLICTS = {
    "no_conflict": "There is no risk of a collision.",
    "potential": "There is a risk of a collision{partner}.",
    "active": "A collision{partner} is imminent.",
    "resolved": "The conflict{partner} has cleared.",
}
_NOBODY = "There are no road users that matter to me."
_LON = {
    "stop": "I stop",
    "decelerate": "I slow down",
    "maintain": "I keep my speed",
    "accelerate": "I accelerate",
}
_LAT = {
    "straight": "stay in my lane",
    "left": "steer to the left",
    "right": "steer to the right",
}


def action_sentence(lon_action: str, lat_action: str) -> str:
    """Return the VUT's own action in words: ``I slow down and stay in my lane``."""
    return f"{_LON[lon_action]} and {_LAT[lat_action]}."


def scene_text(
    objects: tuple[str, ...] | None,
    position: str | None,
    motion: str | None,
    conflict: str | None,
) -> str:
    """Return the closed slots of METHOD 5.1 in full sentences; what is None is left unsaid.

    Args:
        objects: the critical one first; empty says that there is none.
        position: of the critical object, a word of METHOD 5.1.
        motion: of the critical object, a word of METHOD 5.1.
        conflict: a word of METHOD 5.1.
    """
    sentences = []
    critical = objects[0] if objects else ""
    subject = _capital(_noun(critical))
    if objects == ():
        sentences.append(_NOBODY)
    elif critical and (len(objects or ()) > 1 or (position is None and motion is None)):
        # Named together first, so that what follows is said of the critical one only.
        sentences.append(f"I watch {_listed([_noun(word) for word in objects or ()])}.")
        subject = f"The {_word(critical)}"
    predicates = []
    if position is not None:
        predicates.append(f"is {_PLACES[position]}")
    if motion is not None:
        predicates.append(_MOTIONS[motion])
    if predicates:
        sentences.append(f"{subject} {' and '.join(predicates)}.")
    if conflict is not None:
        partner = f" with the {_word(critical)}" if critical else ""
        sentences.append(_CONFLICTS[conflict].format(partner=partner))
    return " ".join(sentences)


def _word(object_class: str) -> str:
    return _noun(object_class).split(" ", 1)[1]


def _noun(object_class: str) -> str:
    return _NOUNS.get(object_class, "an object")


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


# The thresholds of METHOD 6.6.
STOPPED_MPS = 0.5
TREND_MPS2 = 0.5
SIDEWAYS_M = 0.3


def point_times(task: DrivingTask) -> tuple[float, ...]:
    """Return 0, step, 2 step, … up to the task's horizon, s."""
    count = math.floor(task.trajectory_horizon_s / task.trajectory_step_s + 1e-9)
    return tuple(index * task.trajectory_step_s for index in range(count + 1))


def circle_point(distance_m: float, curvature_per_m: float) -> tuple[float, float]:
    """Compute the end of a path of constant curvature: x = sin(κs)/κ, y = (1 − cos κs)/κ, m."""
    turn = distance_m * curvature_per_m
    if abs(turn) < 1e-9:
        return distance_m, distance_m * turn / 2.0
    return math.sin(turn) / curvature_per_m, (1.0 - math.cos(turn)) / curvature_per_m


def travelled_m(time_s: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Return the distance after a time at constant acceleration; braking ends at standstill."""
    if acceleration_mps2 < 0.0:
        time_s = min(time_s, max(0.0, speed_mps) / -acceleration_mps2)
    return speed_mps * time_s + acceleration_mps2 * time_s**2 / 2.0


# Speeds in which every action below is both feasible and recognised (METHOD 6.6).
_SLOWEST_MPS, _FASTEST_MPS = 3.0, 20.0
_ACCELERATION_MPS2 = {"decelerate": -1.5, "maintain": 0.0, "accelerate": 1.5, "stop": -6.0}
_STOP_FROM_MPS = 3.0
_SIDEWAYS_MPS = {"left": 0.8, "straight": 0.0, "right": -0.8}


def action_points(
    lon_action: str, lat_action: str, speed_mps: float, times_s: Sequence[float]
) -> list[tuple[float, float]]:
    """Draw a feasible plan that is read as these two actions (METHOD 6.6).

    Args:
        lon_action: longitudinal, a word of METHOD 5.1.
        lat_action: lateral, a word of METHOD 5.1.
        speed_mps: present speed; what is outside 3 to 20 m/s is taken for the nearest, and a plan
            that stops begins at 3 m/s.
        times_s: of the points.

    Returns:
        x_m, y_m of each point.
    """
    speed = min(max(speed_mps, _SLOWEST_MPS), _FASTEST_MPS)
    if lon_action == "stop":
        speed = _STOP_FROM_MPS
    acceleration, sideways_mps = _ACCELERATION_MPS2[lon_action], _SIDEWAYS_MPS[lat_action]
    return [(travelled_m(t_s, speed, acceleration), sideways_mps * t_s) for t_s in times_s]


def waypoints(points: list[tuple[float, float]], task: DrivingTask) -> NativeArray:
    """Return positions (x_m, y_m) at the task's point times, the first one at t = 0."""
    return NativeArray(
        name=WAYPOINTS_ARRAY,
        shape=(len(points), 2),
        data=tuple(value for point in points for value in point),
        frame=WAYPOINTS_FRAME,
        unit="m",
        step_s=task.trajectory_step_s,
        first_time_s=0.0,
    )
