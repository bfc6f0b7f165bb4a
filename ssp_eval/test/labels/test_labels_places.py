"""Places of labels in their phases: the file's keys, what the check says, which domains compare."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.data.labels import (
    Labels,
    PhasePosition,
    compare_by_scenario,
    compare_labels,
    labels_to_json,
    labels_version,
    load_labels,
    parse_labels,
    phase_counts,
)

AT = [
    {"phase": "approach", "s": 0.5},
    {"phase": "trigger", "u": 0.5},
    {"phase": "conflict", "u": 0.5},
    {"phase": "resolution", "s": 0.25},
]


def content(plan: str | None = "phase", places: list[dict[str, Any]] | None = None) -> Any:
    """Four labels, one in each phase, a second apart."""
    given = AT if places is None else places
    labels = [
        {
            "t_s": float(k),
            "phase": at["phase"],
            "risk_visible": at["phase"] != "approach",
            "objects": ["car"],
            "position": "front",
            "motion": "same_direction",
            "conflict": "active",
            "lon_actions": ["decelerate"],
            "lat_actions": ["straight"],
            **({"at": dict(at)} if plan == "phase" else {}),
        }
        for k, at in enumerate(given)
    ]
    return {
        "schema": "ssp.labels/1",
        "scenario": "cut_in",
        "domain": "simulation",
        "event_version": "sha256:0",
        "risk_time_s": 1.0,
        "first_frame_dynamics": False,
        "labels": labels,
        **({} if plan is None else {"plan": plan}),
    }


def make_labels(**more: Any) -> Labels:
    return parse_labels(content(**more), "l.json")


def test_a_plan_is_read_and_written_as_it_stands(tmp_path: Path) -> None:
    value = content()
    labels = make_labels()
    assert labels.plan == "phase"
    assert [label.at for label in labels.labels] == [
        PhasePosition("approach", 0.5),
        PhasePosition("trigger", 0.5),
        PhasePosition("conflict", 0.5),
        PhasePosition("resolution", 0.25),
    ]
    assert labels_to_json(labels) == value
    path = tmp_path / "l.json"
    path.write_text(json.dumps(value))
    assert load_labels(path) == labels
    last = replace(labels.labels[-1], at=PhasePosition("resolution", 0.75))
    moved = replace(labels, labels=(*labels.labels[:-1], last))
    assert labels_version(moved) != labels_version(labels)


def test_yaml_holds_the_same_keys(tmp_path: Path) -> None:
    path = tmp_path / "l.yaml"
    path.write_text(
        """
schema: ssp.labels/1
plan: phase
scenario: cut_in
domain: simulation
event_version: "sha256:0"
risk_time_s: 1.0
first_frame_dynamics: false
labels:
  - {t_s: 1.0, phase: trigger, at: {phase: trigger, u: 0.5}, risk_visible: true, objects: [car],
     position: front, motion: same_direction, conflict: active, lon_actions: [decelerate],
     lat_actions: [straight]}
"""
    )
    assert load_labels(path).labels[0].at == PhasePosition("trigger", 0.5)


def test_a_file_without_a_plan_is_on_the_clock_and_keeps_its_hash() -> None:
    old, said = make_labels(plan=None), make_labels(plan="clock")
    assert old.plan == said.plan == "clock"
    assert old == said
    assert all(label.at is None for label in old.labels)
    assert labels_to_json(old) == content(plan=None)
    # As it was before there were plans.
    assert labels_version(old) == (
        "sha256:c2f8d8ced7e8a88f4deb6d9dfae2f374827f016b29d239e1fd917a6b5596acd9"
    )


@pytest.mark.parametrize(
    ("change", "field", "what"),
    [
        (lambda v: v.update(plan="both"), "plan", "outside the vocabulary"),
        (lambda v: v.update(plan=None), "plan", "valid string"),
        (lambda v: v.update(plan="clock"), "labels[0].at", "stands in a label on a clock grid"),
        (lambda v: v.pop("plan"), "labels[0].at", "stands in a label on a clock grid"),
        (lambda v: v["labels"][2].pop("at"), "labels[2].at", "is missing"),
        (lambda v: v["labels"][2].update(at=None), "labels[2].at", "is no place"),
        (lambda v: v["labels"][2].update(at={"u": 0.5}), "labels[2].at", "have the keys phase"),
        (lambda v: v["labels"][2]["at"].update(phase="end"), "labels[2].at", "of approach"),
        (lambda v: v["labels"][2]["at"].update(s=1.0), "labels[2].at", "the keys phase .* and u"),
        (
            lambda v: v["labels"][0].update(at={"phase": "approach", "u": 0.5}),
            "labels[0].at",
            "the keys phase .* and s",
        ),
        (lambda v: v["labels"][2].update(at={"phase": "conflict"}), "labels[2].at", "and u"),
        (lambda v: v["labels"][2]["at"].update(u=1.0), "labels[2].at", "no fraction"),
        (lambda v: v["labels"][2]["at"].update(u=0), "labels[2].at", "no fraction"),
        (lambda v: v["labels"][2]["at"].update(u=float("nan")), "labels[2].at", "finite"),
        (lambda v: v["labels"][3]["at"].update(s=-0.1), "labels[3].at", "must not be negative"),
        (lambda v: v["labels"][3]["at"].update(s="0.25"), "labels[3].at", "valid number"),
    ],
)
def test_a_wrong_place_is_refused_with_its_field(
    change: Callable[[Any], object], field: str, what: str
) -> None:
    value = content()
    change(value)
    with pytest.raises(InputError, match=what) as caught:
        parse_labels(value, "l.json")
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            lambda v: v["labels"][1].update(phase="approach"),
            "labels[1].phase: approach, and its place in the plan is trigger u=0.5",
        ),
        (
            lambda v: v["labels"][1].update(phase="conflict", at={"phase": "conflict", "u": 0.6}),
            "labels[2].at: conflict u=0.5 stands after conflict u=0.6",
        ),
        (
            lambda v: v["labels"][1].update(phase="approach", at={"phase": "approach", "s": 1.0}),
            "labels[1].at: approach s=1 stands after approach s=0.5",
        ),
        (lambda v: v["labels"][1].update(t_s=1.9), "labels[2].t_s: 0.100 s after the label before"),
    ],
)
def test_the_check_names_labels_that_are_not_where_their_plan_has_them(
    change: Callable[[Any], object], what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "l.json"
    value = content()
    path.write_text(json.dumps(value))
    assert main(["labels", "check", str(path)]) == 0
    assert "(1/1/1/1 in approach/trigger/conflict/resolution, by phase)" in capsys.readouterr().out
    change(value)
    path.write_text(json.dumps(value))
    assert main(["labels", "check", str(path), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert any(problem.startswith(what) for problem in told["problems"]), told["problems"]
    assert told["plan"] == "phase"
    assert sum(told["phases"].values()) == 4


def test_domains_compare_by_equal_places_or_by_equal_numbers_on_the_clock() -> None:
    one, other = make_labels(), make_labels()
    later = make_labels(places=[*AT[:3], {"phase": "resolution", "s": 0.75}])
    more = make_labels(places=[*AT, {"phase": "resolution", "s": 0.75}])
    clock, short = make_labels(plan=None), make_labels(plan=None, places=AT[:3])
    assert phase_counts(more) == {"approach": 1, "trigger": 1, "conflict": 1, "resolution": 2}

    def verdict(**labels: Labels) -> tuple[bool, bool]:
        found = compare_labels(labels)
        return found.comparable, found.aligned

    assert verdict(synthetic=one, simulation=other, physical=one) == (True, True)
    assert verdict(synthetic=one, simulation=later) == (False, False)
    assert verdict(synthetic=one, simulation=one, physical=more) == (False, False)
    assert verdict(synthetic=clock, simulation=clock) == (True, False)
    assert verdict(synthetic=clock, simulation=short) == (False, False)
    assert verdict(synthetic=one, simulation=clock) == (False, False)
    text = compare_labels({"synthetic": one, "simulation": later}).line
    assert text == (
        "synthetic 1/1/1/1, simulation 1/1/1/1, at other places of the phases in simulation: "
        "not comparable"
    )
    kinds = compare_labels({"synthetic": one, "simulation": clock}).line
    assert "synthetic by phase, simulation by clock: not comparable" in kinds
    assert compare_labels({"synthetic": clock, "simulation": clock}).line.endswith(
        "1/1/1/1: not phase-aligned"
    )
    assert compare_labels({"physical": short}).line == "physical 1/1/1/0"


def test_scenarios_are_compared_each_by_itself() -> None:
    one, more = make_labels(), make_labels(places=[*AT, {"phase": "resolution", "s": 0.75}])
    found = compare_by_scenario(
        [
            ("b", "synthetic", one),
            ("a", "synthetic", one),
            ("b", "simulation", more),
            ("a", "simulation", one),
            ("a", "simulation", more),
        ]
    )
    assert list(found) == ["a", "b"]
    assert found["a"].aligned
    assert not found["b"].comparable
