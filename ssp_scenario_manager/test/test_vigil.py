"""Silence of a participant, at, just inside and just outside its limit."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ssp_core import names
from ssp_core.safety_codes import SafetyCode
from ssp_scenario_manager.core.vigil import (
    CAMERA_SILENT_S,
    RECORDER_SILENT_S,
    WORLD_SILENT_LOCKSTEP_S,
    WORLD_SILENT_REALTIME_S,
    Vigil,
)
from ssp_scenario_manager.resolve import resolve_run
from ssp_scenario_manager.scenario import load_scenario, load_site

EVERYBODY = (names.SIL_WORLD, names.VUT_ID, names.MONITOR, names.FRONT_CAMERA)
NOW_NS = 100_000_000_000


@pytest.fixture(scope="module")
def spec() -> Any:
    scenario, version = load_scenario("cut_in")
    site, site_version = load_site("boulevard")
    return resolve_run(scenario, version, site, site_version, run_id="r", seed=1, mode="lockstep")


def heard_at(ages_s: dict[str, float]) -> Vigil:
    vigil = Vigil()
    for who in EVERYBODY:
        vigil.hear(who, NOW_NS - round(ages_s.get(who, 0.0) * 1e9))
    return vigil


def codes(vigil: Vigil, spec: Any, lockstep: bool = True) -> list[SafetyCode]:
    return [v.code for v in vigil.violations(spec, lockstep, NOW_NS, 7)]


@pytest.mark.parametrize(
    ("who", "limit_s", "code", "lockstep"),
    [
        (names.SIL_WORLD, WORLD_SILENT_LOCKSTEP_S, SafetyCode.WORLD_SILENT, True),
        (names.SIL_WORLD, WORLD_SILENT_REALTIME_S, SafetyCode.WORLD_SILENT, False),
        (names.VUT_ID, WORLD_SILENT_REALTIME_S, SafetyCode.VUT_SILENT, False),
        (names.MONITOR, RECORDER_SILENT_S, SafetyCode.RECORDER, True),
        (names.FRONT_CAMERA, CAMERA_SILENT_S, SafetyCode.PARTICIPANT_LOST, False),
    ],
)
def test_silence_ends_a_run_past_its_limit(
    who: str, limit_s: float, code: SafetyCode, lockstep: bool, spec: Any
) -> None:
    assert codes(heard_at({who: limit_s - 0.001}), spec, lockstep) == []
    assert codes(heard_at({who: limit_s}), spec, lockstep) == []
    assert codes(heard_at({who: limit_s + 0.001}), spec, lockstep) == [code]


def test_who_was_never_heard_is_silent_for_ever(spec: Any) -> None:
    assert Vigil().age_s(names.MONITOR, NOW_NS) == math.inf
    assert codes(Vigil(), spec) == [
        SafetyCode.WORLD_SILENT,
        SafetyCode.VUT_SILENT,
        SafetyCode.RECORDER,
        SafetyCode.PARTICIPANT_LOST,
    ]


def test_a_run_without_a_camera_misses_none(spec: Any) -> None:
    vigil = heard_at({names.FRONT_CAMERA: 60.0})
    assert codes(vigil, spec.model_copy(update={"camera": None})) == []
