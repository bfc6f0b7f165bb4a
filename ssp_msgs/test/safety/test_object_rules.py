"""The rules of an object: every group of fields counts, and only stricter limits may differ."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import ssp_core
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import Motion
from ssp_core.run_file.values import SiteDatum, Start
from ssp_core.safety.object_rules import (
    ObjectRules,
    ReceivedRules,
    RulesCheck,
    check_rules,
    rules_of,
    software_here,
)
from ssp_core.vocabulary import ObjectClass
from tests.support.runs import small_run


def run(**changes: Any) -> RunSpec:
    limits = {"speed_mps": 14.0, "acceleration_mps2": 6.0}
    return RunSpec.model_validate(small_run(**({"limits": limits} | changes)))


OURS = run()
TARGET = OURS.targets[0]


def with_limits(**limits: Any) -> RunSpec:
    return OURS.model_copy(update={"limits": OURS.limits.model_copy(update=limits)})


def with_target(**changes: Any) -> RunSpec:
    return OURS.model_copy(update={"targets": [TARGET.model_copy(update=changes)]})


def check(theirs: RunSpec) -> RulesCheck:
    return check_rules(rules_of(OURS, "ot1"), rules_of(theirs, "ot1"), "ot1")


def test_the_same_file_agrees_however_it_is_written() -> None:
    same = RunSpec.model_validate(json.loads(OURS.model_dump_json(by_alias=True)))
    assert check(same) == RulesCheck(rules_of(OURS, "ot1").digest)
    other_run = OURS.model_copy(update={"run_id": "another", "seed": 7})
    assert rules_of(other_run, "ot1").digest == rules_of(OURS, "ot1").digest


FENCE = [(0.0, -8.0), (1600.0, -8.0), (1600.0, 12.0), (0.0, 12.0)]
PATH = Motion(path=[(40.0, 0.0), (90.0, 0.0)], cruise_mps=5.0)
LATER = Start(x_m=40.0, y_m=0.5, yaw_rad=0.0)
MANOEUVRE = OURS.triggers[0].manoeuvre.model_copy(update={"lateral_shift_m": -1.0})
TRIGGER = OURS.triggers[0].model_copy(update={"manoeuvre": MANOEUVRE})
DATUM = SiteDatum(latitude_deg=57.0, longitude_deg=12.0)


@pytest.mark.parametrize(
    ("theirs", "field", "its", "mine"),
    [
        (
            OURS.model_copy(update={"geofence": FENCE}),
            "geofence[1]",
            "[1600.0, -8.0]",
            "[400.0, -8.0]",
        ),
        (
            OURS.model_copy(update={"geofence": [*FENCE, (0.0, 0.0)]}),
            "geofence[1]",
            "[1600",
            "[400",
        ),
        (with_limits(speed_mps=40.0), "limits.speed_mps", "40.0", "14.0"),
        (with_limits(heartbeat_s=60.0), "limits.heartbeat_s", "60.0", "0.5"),
        (with_limits(separation_m=0.0), "limits.separation_m", "0.0", "0.5"),
        (with_limits(stop_deceleration_mps2=5.0), "limits.stop_deceleration_mps2", "5.0", "4.0"),
        (with_limits(stop_deceleration_mps2=3.0), "limits.stop_deceleration_mps2", "3.0", "4.0"),
        (with_limits(trigger_age_s=0.05), "limits.trigger_age_s", "0.05", "0.04"),
        (with_limits(speed_mps=1.0, jump_m=2.0), "limits.jump_m", "2.0", "1.0"),
        (OURS.model_copy(update={"step_s": 0.01}), "step_s", "0.01", "0.02"),
        (OURS.model_copy(update={"mode": "realtime"}), "mode", '"realtime"', '"lockstep"'),
        (OURS.model_copy(update={"event_version": "b"}), "event_version", '"b"', '"sha256:event"'),
        (OURS.model_copy(update={"datum": DATUM}), "datum", "given", "null"),
        (with_target(start=LATER), "ot1.start.y_m", "0.5", "0.0"),
        (with_target(object_class="truck"), "ot1.object_class", '"truck"', '"car"'),
        (with_target(approach=PATH), "ot1.approach", "given", "null"),
        (
            OURS.model_copy(update={"triggers": [TRIGGER]}),
            "ot1.manoeuvres.t.lateral_shift_m",
            "-1.0",
            "-3.5",
        ),
    ],
)
def test_another_field_is_named_with_both_values(
    theirs: RunSpec, field: str, its: str, mine: str
) -> None:
    found = check(theirs)
    assert found.digest == rules_of(theirs, "ot1").digest != rules_of(OURS, "ot1").digest
    assert found.problem.startswith(f"ot1 judges by another {field}: {its}"), found.problem
    assert f"on its host, {mine}" in found.problem


def test_a_size_and_a_version_of_the_product_count() -> None:
    ours = rules_of(OURS, "ot1")
    wider = ObjectRules(ours.software, {**ours.values, "ot1.size.width_m": "9.0"})
    assert "another ot1.size.width_m: 9.0" in check_rules(ours, wider, "ot1").problem
    older = ObjectRules("0.0.9", ours.values)
    problem = check_rules(ours, older, "ot1").problem
    assert problem == f"ot1 judges by another software: 0.0.9 on its host, {ours.software} here"
    assert check_rules(ours, older, "ot1").digest == older.digest != ours.digest
    more = ObjectRules(ours.software, {**ours.values, "limits.jerk": "1"})
    assert (
        "another limits.jerk: 1 on its host, nothing here" in check_rules(ours, more, "ot1").problem
    )


def test_the_rules_name_the_software_here_and_the_body_of_the_object() -> None:
    rules = rules_of(OURS, "ot1")
    version, plus, sources = software_here().partition("+")
    assert (rules.software, version, plus) == (software_here(), ssp_core.__version__, "+")
    assert len(sources) == 12
    given = {name: value for name, value in rules.values.items() if ".size." in name}
    size = DEFAULT_SIZES[ObjectClass.CAR]
    assert given == {f"ot1.size.{name}": f"{value}" for name, value in asdict(size).items()}
    assert (rules.values["step_s"], rules.values["geofence[1]"]) == ("0.02", "[400.0, -8.0]")


@pytest.mark.parametrize(
    "changed",
    [
        "ssp_core/safety/fence.py",
        "ssp_core/geometry.py",
        "ssp_ot_controller/objects/local_safety.py",
        "ssp_ot_controller/control/stopping.py",
        "ssp_ot_controller/bodies/dynamics.py",
    ],
)
def test_another_checkout_of_the_same_version_counts(changed: str, tmp_path: Path) -> None:
    """Its process names other software than ours; one of the same sources elsewhere doesn't."""
    ours = rules_of(OURS, "ot1").software
    objects = find_spec("ssp_ot_controller")
    assert objects is not None
    assert objects.origin is not None
    for package in (Path(ssp_core.__file__).parent, Path(objects.origin).parent):
        shutil.copytree(package, tmp_path / package.name)
    assert _software_of(tmp_path) == ours
    source = tmp_path / changed
    source.write_text(source.read_text().replace("return", "return  # of yesterday", 1))
    assert _software_of(tmp_path) != ours
    assert _software_of(tmp_path).partition("+")[0] == ours.partition("+")[0]


def _software_of(folder: Path) -> str:
    """Return what a process says that imports the packages of a folder."""
    code = "from ssp_core.safety.object_rules import software_here; print(software_here())"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


NUMBERS = [name for name in Limits.model_fields if isinstance(getattr(OURS.limits, name), float)]


@pytest.mark.parametrize("name", NUMBERS)
def test_a_limit_is_stricter_on_one_side_at_most(name: str) -> None:
    """Each limit may be lower, or may be higher, on the object's host, never both."""
    value = getattr(OURS.limits, name)
    lower, higher = (
        check(with_limits(**{name: 0.5 * value})),
        check(with_limits(**{name: 2 * value})),
    )
    allowed = [one for one in (lower, higher) if not one.problem]
    assert len(allowed) == (0 if name == "stop_deceleration_mps2" else 1)
    for one in allowed:
        assert one.stricter[0].startswith(f"limits.{name} ")
        assert one.stricter[0].endswith(f" instead of {value}")
    assert (not higher.problem) == (name == "separation_m")


@pytest.mark.parametrize("told", ['"fast"', "null", "NaN", "[1.0]", "14", "", None])
@pytest.mark.parametrize("name", ["limits.speed_mps", "limits.separation_m"])
def test_a_limit_that_is_no_lower_number_is_not_stricter(name: str, told: str | None) -> None:
    ours = rules_of(with_limits(separation_m=14.0), "ot1")
    values = {**ours.values, name: told}
    its = ObjectRules(ours.software, {k: v for k, v in values.items() if v is not None})
    found = check_rules(ours, its, "ot1")
    words = "nothing" if told is None else told
    assert found.problem == f"ot1 judges by another {name}: {words} on its host, 14.0 here"
    assert found.stricter == ()


def test_a_field_that_is_named_like_a_limit_is_none() -> None:
    ours = rules_of(OURS, "ot1")
    mine, its = (
        ObjectRules(ours.software, {**ours.values, "speed_mps": value}) for value in ("9.0", "1.0")
    )
    assert "another speed_mps: 1.0 on its host" in check_rules(mine, its, "ot1").problem


def fenced(*corners: tuple[float, float]) -> RulesCheck:
    return check(OURS.model_copy(update={"geofence": list(corners)}))


@pytest.mark.parametrize(
    ("corners", "inside"),
    [
        ([(0.0, -8.0), (300.0, -8.0), (300.0, 12.0), (0.0, 12.0)], True),
        ([(10.0, -4.0), (300.0, -4.0), (300.0, 8.0)], True),
        ([(400.0, -8.0), (400.0, 12.0), (0.0, 12.0), (0.0, -8.0)], True),  # from another corner
        ([(0.0, -8.0), (300.0, -8.0), (300.0, 12.001), (0.0, 12.0)], False),
        ([(0.0, 20.0), (300.0, 20.0), (300.0, 40.0), (0.0, 40.0)], False),
        ([(10.0, -4.0), (300.0, -4.0)], False),
        ([(10.0, -4.0), (300.0, 8.0), (300.0, -4.0), (10.0, 8.0)], False),  # crosses itself
    ],
)
def test_a_fence_of_its_own_lies_inside_the_runs(
    corners: list[tuple[float, float]], inside: bool
) -> None:
    found = fenced(*corners)
    assert (not found.problem) is inside
    assert found.stricter == (("geofence, inside the one here",) if inside else ())


def test_a_fence_inside_the_hull_but_across_a_notch_is_another_one() -> None:
    notch = [(0.0, -8.0), (400.0, -8.0), (400.0, 12.0), (201.0, 12.0), (200.0, -7.0), (199.0, 12.0)]
    ours = OURS.model_copy(update={"geofence": [*notch, (0.0, 12.0)]})
    inner = OURS.model_copy(update={"geofence": [(9.0, -5.0), (390.0, -5.0), (390.0, 9.0)]})
    mine, its = rules_of(ours, "ot1"), rules_of(inner, "ot1")
    problem = check_rules(mine, its, "ot1").problem
    assert problem.startswith("ot1 judges by another geofence[0]: [9.0, -5.0]")
    for text in ('"x"', "[NaN, 0.0]", "[1.0]", "[9.0, -5.0]"):
        broken = ObjectRules(its.software, {**its.values, "geofence[1]": text})
        assert "another geofence" in check_rules(mine, broken, "ot1").problem


def test_a_trigger_age_that_is_not_given_is_two_periods() -> None:
    assert check(with_limits(trigger_age_s=0.04)).problem == ""
    assert check(with_limits(trigger_age_s=0.01)).stricter == (
        "limits.trigger_age_s 0.01 instead of 0.04",
    )


def test_what_was_heard_last_counts() -> None:
    heard = ReceivedRules()
    assert heard.checks(OURS)["ot1"] == RulesCheck(problem="ot1 has not said what it judges by")
    heard.hear(("ot1", rules_of(with_limits(speed_mps=40.0), "ot1")))
    assert heard.checks(OURS)["ot1"].problem
    heard.hear(("ot1", rules_of(with_limits(speed_mps=8.0), "ot1")))
    assert heard.checks(OURS)["ot1"].stricter == ("limits.speed_mps 8.0 instead of 14.0",)
    assert heard.checks(with_limits(speed_mps=8.0))["ot1"].stricter == ()
