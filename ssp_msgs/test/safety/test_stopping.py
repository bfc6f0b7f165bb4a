"""The stated bound of stopping distances."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.run_file.model import Limits
from ssp_core.safety.stopping import BRAKE_LAG_S, SERVICE_BRAKE_MPS2, Stopping, stopping_of
from ssp_core.vocabulary import ObjectClass

SITE = Limits(speed_mps=15.0, acceleration_mps2=5.0)


def test_the_bound_is_blind_time_plus_braking_plus_margin() -> None:
    stopping = Stopping(reaction_s=0.3, deceleration_mps2=4.0, margin_m=0.5)
    assert stopping.distance_m(10.0, 0.5) == pytest.approx(10.0 * 0.8 + 100.0 / 8.0 + 0.5)
    assert stopping.duration_s(10.0, 0.5) == pytest.approx(0.8 + 2.5)
    assert stopping.distance_m(0.0, 0.5) == 0.5


def test_a_site_and_a_body_both_bound_the_deceleration() -> None:
    assert stopping_of(ObjectClass.CAR, SITE, 0.02).deceleration_mps2 == 4.0
    assert stopping_of(ObjectClass.PEDESTRIAN, SITE, 0.02).deceleration_mps2 == 3.0
    gentle = SITE.model_copy(update={"acceleration_mps2": 2.0})
    assert stopping_of(ObjectClass.CAR, gentle, 0.02).deceleration_mps2 == 2.0
    assert stopping_of(ObjectClass.CAR, SITE, 0.02).reaction_s == pytest.approx(0.29)


def test_every_class_with_a_body_is_stated() -> None:
    classes = set(ObjectClass) - {ObjectClass.UNKNOWN}
    assert set(BRAKE_LAG_S) == set(SERVICE_BRAKE_MPS2) == classes


@given(st.floats(0.0, 40.0), st.floats(0.0, 2.0), st.sampled_from(sorted(SERVICE_BRAKE_MPS2)))
def test_more_speed_or_a_longer_silence_never_stops_sooner(
    speed_mps: float, timeout_s: float, cls: ObjectClass
) -> None:
    stopping = stopping_of(cls, SITE, 0.02)
    here = stopping.distance_m(speed_mps, timeout_s)
    assert stopping.distance_m(speed_mps + 0.1, timeout_s) > here
    assert stopping.distance_m(speed_mps, timeout_s + 0.1) >= here
