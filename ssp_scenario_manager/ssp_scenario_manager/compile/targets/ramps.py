"""Speeds of a task as straight ramps, and its object classes as other players know them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.geometry import Polyline
from ssp_core.motion.speed_profile import DEFAULT_RAMP_S
from ssp_core.run_file.participants import Motion
from ssp_core.vocabulary import ObjectWord
from ssp_scenario_manager.dispatch.references import APPROACH_LEAD_S

# When a target's ramp begins, s after the session's start.
TARGET_START_S = APPROACH_LEAD_S + DEFAULT_RAMP_S / 2
# Shorter than this a ramp is a step to a player.
_LEAST_S = 0.01
# The length of a sine is a mean over so many parts of it.
_SINE_STEPS = 200


@dataclass(frozen=True, slots=True)
class Ramp:
    """A change of speed at a constant rate."""

    to_mps: float
    duration_s: float


def ramp(from_mps: float, to_mps: float, rate_mps2: float) -> Ramp:
    """Make the ramp from one speed to another at a rate > 0."""
    return Ramp(to_mps, max(abs(to_mps - from_mps) / rate_mps2, _LEAST_S))


@dataclass(frozen=True, slots=True)
class Journey:
    """A drive from standstill along a path to a standstill at its end.

    Args:
        start: up to the highest speed that the path has room for.
        stop: back to standstill.
        braking_from_m: distance driven when the stop begins.
    """

    start: Ramp
    stop: Ramp
    braking_from_m: float
    length_m: float


def journey(motion: Motion) -> Journey:
    """Return a motion's ramps and where the last one begins."""
    a, d = motion.acceleration_mps2, motion.deceleration_mps2
    length = Polyline(motion.path).length_m
    peak = min(motion.cruise_mps, math.sqrt(2.0 * a * d * length / (a + d)))
    return Journey(ramp(0.0, peak, a), ramp(peak, 0.0, d), length - peak * peak / (2.0 * d), length)


@dataclass(frozen=True, slots=True)
class Leg:
    """A ramp and when it begins, s after the session's start."""

    start_s: float
    change: Ramp


def legs(speeds: Sequence[tuple[float, float]], error_mps: float = 0.05) -> list[Leg]:
    """Return straight ramps that leave a course of speeds by at most an error.

    Args:
        speeds: (t in s, speed in m/s), t rising strictly, at least one.
        error_mps: largest difference at a given time.
    """
    knots = _knots(speeds, 0, len(speeds) - 1, error_mps)
    return [
        Leg(speeds[a][0], Ramp(round(speeds[b][1], 3), speeds[b][0] - speeds[a][0]))
        for a, b in pairwise([0, *knots])
    ]


# How much a metre counts beside a metre per second.
_WAY_WEIGHT = 5.0


def matched(
    ramp_legs: Sequence[Leg], speeds: Sequence[tuple[float, float]], driven_m: Sequence[float]
) -> list[Leg]:
    """Change the speeds of straight ramps so that the distance driven is the course's too.

    Chords of a course that bends one way lie on one side of it, and their error adds up. The speeds
    are those of the least squares of both errors.

    Args:
        ramp_legs: ramps that follow one another from the course's first time on.
        speeds: the course, (t in s, m/s).
        driven_m: distance since its beginning at these times.
    """
    times, course_mps = np.array(speeds).T
    knots = [ramp_legs[0].start_s, *(leg.start_s + leg.change.duration_s for leg in ramp_legs)]
    hats = np.stack([np.interp(times, knots, row) for row in np.eye(len(knots))], axis=1)
    steps = 0.5 * (hats[1:] + hats[:-1]) * np.diff(times)[:, None]
    ways = np.concatenate([np.zeros((1, len(knots))), np.cumsum(steps, axis=0)])
    rows = np.concatenate([hats, _WAY_WEIGHT * ways])
    goals = np.concatenate([course_mps, _WAY_WEIGHT * (np.array(driven_m) - driven_m[0])])
    rest = goals - rows[:, 0] * course_mps[0]
    fitted = np.linalg.lstsq(rows[:, 1:], rest, rcond=None)[0]
    return [
        Leg(leg.start_s, Ramp(max(0.0, round(float(speed), 3)), leg.change.duration_s))
        for leg, speed in zip(ramp_legs, fitted, strict=True)
    ]


def _knots(speeds: Sequence[tuple[float, float]], a: int, b: int, error_mps: float) -> list[int]:
    """Return indices after ``a``, up to ``b``, between which straight lines are near enough."""
    if b <= a:
        return []
    (t0, v0), (t1, v1) = speeds[a], speeds[b]
    worst, at = 0.0, a
    for i in range(a + 1, b):
        t, v = speeds[i]
        off = abs(v - v0 - (v1 - v0) * (t - t0) / (t1 - t0))
        if off > worst:
            worst, at = off, i
    if worst <= error_mps:
        return [b]
    return _knots(speeds, a, at, error_mps) + _knots(speeds, at, b, error_mps)


def times_along(motion: Motion) -> list[tuple[float, float, float]]:
    """Return (t in s from the start, x, y) at the points of a motion's path, as planned."""
    path = Polyline(motion.path)
    trip = journey(motion)
    a, d, peak = motion.acceleration_mps2, motion.deceleration_mps2, trip.start.to_mps
    speeding = peak * peak / (2.0 * a)
    end_s = peak / a + (trip.braking_from_m - speeding) / peak + peak / d

    def when(station_m: float) -> float:
        if station_m <= speeding:
            return math.sqrt(2.0 * max(station_m, 0.0) / a)
        if station_m <= trip.braking_from_m:
            return peak / a + (station_m - speeding) / peak
        return end_s - math.sqrt(2.0 * max(trip.length_m - station_m, 0.0) / d)

    return [
        (when(float(s)), float(x), float(y))
        for s, (x, y) in zip(path.stations_m, path.points, strict=True)
    ]


def distance_during(from_mps: float, change: Ramp, duration_s: float) -> float:
    """Return the distance driven in a time that begins with a ramp, m."""
    within = min(duration_s, change.duration_s)
    rate = (change.to_mps - from_mps) / change.duration_s
    ramped = from_mps * within + 0.5 * rate * within * within
    return ramped + change.to_mps * (duration_s - within)


def sine_length_m(along_m: float, across_m: float) -> float:
    """Return the length of half a sine from one lane's middle to another's, m.

    Args:
        along_m: between its ends, along the lane.
        across_m: between its ends, across the lane.
    """
    turn = (np.arange(_SINE_STEPS) + 0.5) * (math.pi / _SINE_STEPS)
    rates = 0.5 * math.pi * across_m / along_m * np.sin(turn)
    return along_m * float(np.mean(np.hypot(1.0, rates)))


@dataclass(frozen=True, slots=True)
class ClassFacts:
    """One object class elsewhere.

    Args:
        blueprint: of CARLA 0.9.16; ScenarioRunner takes it from the entity's name or model.
        category: OpenSCENARIO's vehicle category; None for a pedestrian.
        wheelbase_m: front axle ahead of the reference point, which is below the rear axle.
        track_m: between the wheels of an axle.
        wheel_m: wheel diameter.
        steering_rad: largest steering angle.
        speed_mps: highest speed that the body can drive.
        acceleration_mps2: highest acceleration of the body.
        deceleration_mps2: highest deceleration of the body.
        mass_kg: of a pedestrian.
    """

    blueprint: str
    category: xosc.VehicleCategory | None
    wheelbase_m: float
    track_m: float
    wheel_m: float
    steering_rad: float
    speed_mps: float
    acceleration_mps2: float
    deceleration_mps2: float
    mass_kg: float


_CATEGORY = xosc.VehicleCategory
# CARLA's bodies nearest in size to ours (ssp_core.motion.state.DEFAULT_SIZES). The speeds and
# accelerations bound what a player may do with the body and lie above what a task asks of it.
# fmt: off
CLASSES: dict[ObjectWord, ClassFacts] = {
    # blueprint and category; wheelbase, track, wheel, steering, speed, both accelerations, mass
    "car": ClassFacts("vehicle.tesla.model3", _CATEGORY.car,
                      2.7, 1.6, 0.65, 0.6, 60.0, 10.0, 10.0, 1700.0),
    "truck": ClassFacts("vehicle.carlamotors.firetruck", _CATEGORY.truck,
                        5.2, 2.1, 1.0, 0.6, 30.0, 5.0, 8.0, 12000.0),
    "bus": ClassFacts("vehicle.mitsubishi.fusorosa", _CATEGORY.bus,
                      6.0, 2.1, 1.0, 0.7, 30.0, 5.0, 8.0, 11000.0),
    "motorcycle": ClassFacts("vehicle.kawasaki.ninja", _CATEGORY.motorbike,
                             1.4, 0.01, 0.6, 0.5, 60.0, 10.0, 10.0, 220.0),
    "cyclist": ClassFacts("vehicle.bh.crossbike", _CATEGORY.bicycle,
                          1.0, 0.01, 0.7, 0.7, 15.0, 4.0, 6.0, 90.0),
    "pedestrian": ClassFacts("walker.pedestrian.0001", None,
                             0.0, 0.0, 0.0, 0.0, 6.0, 5.0, 5.0, 75.0),
}
# fmt: on
