"""An object whose heading isn't known at rest: its first metre shows whether it faces its start."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.limits import LimitViolation, has_stood
from ssp_core.safety.start_heading import start_heading
from ssp_core.vocabulary import ObjectClass, Role
from tests.support.tracks import RATES_HZ, SOURCES, Row, measured, motion

S = 1_000_000_000
LIMITS = Limits(speed_mps=30.0, acceleration_mps2=5.0, heading_by_course=["one"])


def judged(
    rows: list[Row], yaw_rad: float, cls: ObjectClass = ObjectClass.CAR, limits: Limits = LIMITS
) -> tuple[float, LimitViolation] | None:
    """Return when the first metre contradicted a start's heading, and the limit violated."""
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=yaw_rad)
    one = ParticipantSpec(id="one", object_class=cls.name.lower(), start=start)
    watch, heading = ConsistencyWatch(Bounds.of("one", cls, limits)), start_heading(one, limits)
    assert heading is not None
    for t_s, x, y, yaw, v, std in rows:
        state = ObjectState(
            "one",
            cls,
            Role.VUT,
            round(t_s * S),
            x,
            y,
            yaw,
            v,
            0.0,
            0.0,
            DEFAULT_SIZES[cls],
            position_std_m=std,
        )
        watch.see(state)
        if (found := heading.see(state, stands=has_stood(state, watch))) is not None:
            return t_s, found
    return None


def way(
    course_rad: float, speed: float, *, step_m: float = 0.0, rate_hz: float = 50.0
) -> list[Row]:
    """A source without noise that stands for a second; what it states as yaw has no meaning."""
    rows = []
    for k in range(round(4.0 * rate_hz)):
        t = k / rate_hz
        s = abs(speed) * max(t - 1.0, 0.0)
        x, y = s * math.cos(course_rad) - step_m * (t > 1.2), s * math.sin(course_rad)
        rows.append((t, x, y, -2.0, speed * (t > 1.0), 0.02))
    return rows


@pytest.mark.parametrize("rate_hz", [5.0, 50.0])
@pytest.mark.parametrize("yaw_rad", [0.0, 2.0, -3.0])
def test_who_drives_the_other_way_is_found_within_a_metre_and_a_half(
    yaw_rad: float, rate_hz: float
) -> None:
    assert judged(way(yaw_rad + 0.3, 2.0, rate_hz=rate_hz), yaw_rad) is None
    found = judged(way(yaw_rad + math.pi, 2.0, rate_hz=rate_hz), yaw_rad)
    assert found is not None
    assert found[1].code is SafetyCode.STATE_CONTRADICTS
    assert "lead +180° off its start's heading, limit 20°" in found[1].words
    assert (found[0] - 1.0) * 2.0 <= 2.5


def test_who_states_that_it_reverses_faces_its_start() -> None:
    assert judged(way(math.pi, -2.0), 0.0) is None
    assert judged(way(0.0, -2.0), 0.0) is not None
    assert judged(way(math.pi / 2.0, -2.0), 0.0) is not None


def test_a_person_may_go_backwards_and_what_is_omnidirectional_anywhere() -> None:
    backwards, sideways = way(math.pi, 1.5), way(math.pi / 2.0, 1.5)
    assert judged(backwards, 0.0, ObjectClass.PEDESTRIAN) is None
    assert judged(sideways, 0.0, ObjectClass.PEDESTRIAN) is not None
    any_way = LIMITS.model_copy(update={"omnidirectional": ["one"]})
    assert judged(sideways, 0.0, limits=any_way) is None


def test_one_correction_of_the_receiver_is_no_way() -> None:
    assert judged(way(0.0, 1.0, step_m=0.99), 0.0) is None
    assert judged(way(math.pi, 1.0, step_m=0.99), 0.0) is not None


def test_an_object_that_is_not_listed_is_not_watched() -> None:
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    one = ParticipantSpec(id="two", object_class="car", start=start)
    assert start_heading(one, LIMITS) is None


def test_of_200_sound_tracks_none_is_taken_for_turned_and_each_that_is_turned_is_found() -> None:
    manoeuvres = ("drive", "walk", "reverse", "stand", "dropout")
    cases = list(product(manoeuvres, SOURCES, RATES_HZ))
    for seed in range(200):
        manoeuvre, source, rate_hz = case = cases[seed % len(cases)]
        random = np.random.default_rng(seed)
        true = motion(manoeuvre, random)
        rows = list(measured(true, SOURCES[source], rate_hz, random))
        yaw_rad = float(true.rows[200, 3])  # where it sets off
        cls = ObjectClass.PEDESTRIAN if true.walks else ObjectClass.CAR
        assert judged(rows, yaw_rad, cls) is None, (seed, case)
        if manoeuvre in ("drive", "reverse", "dropout"):
            assert judged(rows, yaw_rad + math.pi, cls) is not None, (seed, case)
