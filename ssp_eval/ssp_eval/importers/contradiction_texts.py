"""The texts on a motion that contradicts its places: what, where, and the remedy."""

from __future__ import annotations

import math

import numpy as np

from ssp_core.geometry import FloatArray, wrap_angles
from ssp_core.safety.consistency import DIRECTION_MPS, direction_bound_rad
from ssp_core.safety.window import SPEED_MPS, UNITS, either, known_factors
from ssp_core.vocabulary import ObjectClass
from ssp_eval.importers.contradictions import Contradiction, Course


def problem_and_remedy(
    one: Contradiction, course: Course, velocity_mps: FloatArray, object_id: str
) -> tuple[str, str]:
    """Return a clause on the problem and its place, and one on the remedy.

    Args:
        one: the contradiction.
        course: of the object.
        velocity_mps: by the places, shape (n, 2).
        object_id: its id.
    """
    match one.name:
        case "clock_step":
            problem, remedy = _tell_clock_step(course, one)
        case "leap":
            problem, remedy = _tell_leap(course, one)
        case "heading":
            problem, remedy = _tell_heading(object_id, course, velocity_mps, one)
        case "speed":
            problem, remedy = _tell_speed(course, one)
        case "sideways":
            problem, remedy = _tell_sideways(object_id, course, one)
    if one.stretches > 1:
        problem += f"; {one.stretches - 1} more such stretches"
    return problem, remedy


def _span(course: Course, one: Contradiction) -> str:
    first_s, last_s = course.t_s[one.first], course.t_s[one.last]
    return f"from {first_s:.2f} s to {last_s:.2f} s after its first sample"


def _tell_clock_step(course: Course, one: Contradiction) -> tuple[str, str]:
    step_s = float(course.t_s[one.last] - course.t_s[one.first])
    why = f": {one.why}" if one.why else ""
    return (
        f"moves by {one.way * step_s:.1f} m within {step_s:.2f} s, at {course.t_s[one.first]:.2f} "
        f"s after its first sample, where it goes at {one.stated:.2f} m/s{why}",
        "cut the span out with --start and --end; of a bag --clock receive takes the times of "
        "receipt",
    )


def _tell_leap(course: Course, one: Contradiction) -> tuple[str, str]:
    step_s = float(course.t_s[one.last] - course.t_s[one.first])
    return (
        f"jumps by {one.way:.1f} m within {step_s:.2f} s: one id must be one object",
        "mend the ids, or cut the span out with --start and --end",
    )


def _tell_heading(
    object_id: str, course: Course, velocity: FloatArray, one: Contradiction
) -> tuple[str, str]:
    remedy = (
        "headings are in rad, counter-clockwise from +x; where the source has none that hold, "
        f"--heading {object_id}=motion takes them from the motion"
    )
    off_deg = abs(one.stated)
    if not one.is_whole:
        why = f" ({one.why})" if one.why else ""
        return (
            f"has headings that lie {off_deg:.0f} degrees off its direction of motion "
            f"{_span(course, one)}{why}",
            remedy,
        )
    moving = np.linalg.norm(velocity, axis=1) >= DIRECTION_MPS
    if not moving.any() or course.yaw_rad is None:
        moving = np.ones(len(course.t_s), dtype=bool)
    own = np.zeros(len(course.t_s)) if course.yaw_rad is None else course.yaw_rad
    own, towards = own[moving], np.arctan2(velocity[moving, 1], velocity[moving, 0])
    if course.speed_mps is not None:
        towards = towards + math.pi * (course.speed_mps[moving] < 0.0)

    def off_rad(heading: FloatArray) -> float:
        return float(np.median(np.abs(wrap_angles(heading - towards))))

    guesses = {
        "they look like degrees": np.radians(own),
        "they look like compass degrees, clockwise from north": np.radians(90.0 - own),
        "they look clockwise from +y, as a compass counts": math.pi / 2.0 - own,
        "they look clockwise, as in a left-handed frame": -own,
        "they look turned by half a turn: does y or the order of axes agree with x?": own + math.pi,
    }
    best = min(guesses, key=lambda text: off_rad(guesses[text]))
    bound = direction_bound_rad(ObjectClass.CAR) / 2.0
    hint = f" ({best})" if off_rad(guesses[best]) < bound else ""
    off_deg = math.degrees(off_rad(own))
    return f"has headings that lie {off_deg:.0f} degrees off its direction of motion{hint}", remedy


def _tell_speed(course: Course, one: Contradiction) -> tuple[str, str]:
    remedy = "speeds are in m/s, positions in m, times in s, all of one run"
    if not one.is_whole or one.way < SPEED_MPS:
        why = f" ({one.why})" if one.why else ""
        return (
            f"states {one.stated:.2f} m/s {_span(course, one)}, while its positions go at "
            f"{one.way:.2f} m/s{why}",
            f"{remedy}; cut the span out with --start and --end",
        )
    ratio = abs(one.stated) / one.way
    return (
        f"has speeds {ratio:.3g} times those of its positions ({one.way:.2f} m/s at "
        f"{course.t_s[one.first]:.2f} s after its first sample){_unit_hint(one.factors)}",
        remedy,
    )


def _tell_sideways(object_id: str, course: Course, one: Contradiction) -> tuple[str, str]:
    return (
        f"moves across its heading by {one.stated:.2f} m/s at {one.way:.2f} m/s, "
        f"{_span(course, one)}",
        f"name the point that its poses are of with --reference {object_id}=POINT; --heading "
        f"{object_id}=motion takes the heading from the motion",
    )


_FACTORS = {
    **{f"speeds in {unit}": factor for unit, factor in UNITS.items()},
    "times in ms, or positions in km": 1000.0,
    "positions in cm": 0.01,
    "positions in mm": 0.001,
    "positions in feet": 0.3048,
}


def _unit_hint(factors: tuple[float, float] | None) -> str:
    units = () if factors is None else known_factors(*factors, _FACTORS)[0]
    return f": {either(units)}?" if units else ": another run's, or another time base?"
