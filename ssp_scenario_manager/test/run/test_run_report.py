"""The run's report: latencies, motion onset, tracking errors, missing states; on given data."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ssp_core.cdr.references import Acknowledgement
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.run.report import (
    QUANTITIES,
    ReportInput,
    bands,
    differences,
    lines,
    measured,
    onset,
    receipt,
    report_fields,
    tracking,
)

MS = 1_000_000
S = 1_000_000_000
START_NS = 1_700_000_000 * S  # of a live session
StateMaker = Callable[..., ObjectState]


def reference(name: str, execute_at_ns: int, speed_mps: float, curvature_1pm: float = 0.0) -> Any:
    """20 s at one speed."""
    points = tuple(
        ReferencePoint(t, speed_mps * t, 0.0, 0.0, speed_mps, 0.0, curvature_1pm)
        for t in (0.0, 10.0, 20.0)
    )
    return Reference(
        name,
        "ot1",
        "v",
        "approach",
        execute_at_ns - 100 * MS,
        execute_at_ns,
        execute_at_ns + S,
        points,
    )


def drive(
    state: StateMaker, sigma: float = 0.0, braking_from_s: float = 99.0, seconds: float = 8.0
) -> list[ObjectState]:
    """Return states at 50 Hz: 7 m/s with noise, until the object brakes at 2 m/s^2."""
    noise = random.Random(7)
    found = []
    for i in range(round(seconds * 50)):
        t = i / 50
        late = max(0.0, t - braking_from_s)
        found.append(
            state(
                "ot1",
                stamp_ns=START_NS + i * 20 * MS,
                sequence=i + 1,
                speed_mps=7.0 - 2.0 * late + noise.gauss(0.0, sigma),
                acceleration_mps2=-2.0 if late else 0.0,
                reference_id="a",
                control_state=ControlState.RUNNING,
            )
        )
    return found


# -- onset ----------------------------------------------------------------------------------------


def test_difference_from_what_was_asked(state: StateMaker) -> None:
    turning = state("ot1", stamp_ns=S, speed_mps=8.0, yaw_rate_radps=0.5, acceleration_mps2=-1.0)
    asked = reference("a", 0, 7.0, 0.1)
    assert differences([turning], asked)[0] == pytest.approx([1.0, -1.0, 4.0 - 4.9])
    assert differences([turning], None)[0, 0] == 8.0


def test_bands_are_measured_and_no_narrower_than_a_state_is_worth(state: StateMaker) -> None:
    asked = reference("a", START_NS, 7.0)
    still = bands(drive(state), asked, START_NS + 5 * S)
    assert still is not None
    assert [list(part) for part in still] == [[0.0, 0.0, 0.0], [0.02, 0.05, 0.05]]
    noisy = bands(drive(state, sigma=0.1), asked, START_NS + 5 * S)
    assert noisy is not None
    assert noisy[1][0] == pytest.approx(0.4, rel=0.25)


def test_a_band_needs_states_of_the_same_reference(state: StateMaker) -> None:
    states = drive(state)
    assert bands(states, reference("b", START_NS, 7.0), START_NS + 5 * S) is None
    asked = reference("a", START_NS, 7.0)
    assert bands(states[:4], asked, START_NS + S) is None
    assert bands(states[:5], asked, START_NS + S) is not None
    # States from more than two seconds before say nothing of the noise.
    assert bands(states[:5], asked, START_NS + 3 * S) is None


def test_the_onset_is_the_first_state_that_departs(state: StateMaker) -> None:
    asked = reference("a", START_NS, 7.0)
    for sigma in (0.0, 0.1):
        states = drive(state, sigma, braking_from_s=5.1)
        noise = bands(states, asked, START_NS + 5 * S)
        assert noise is not None
        found = onset(states, asked, noise, START_NS + 5 * S, START_NS + 5 * S + 100 * MS)
        assert found is not None
        departed, quantity = found
        assert departed.stamp_ns == START_NS + 5 * S + 120 * MS
        assert QUANTITIES[quantity] == "acceleration"


def test_one_state_outside_the_band_is_noise(state: StateMaker) -> None:
    asked = reference("a", START_NS, 7.0)
    states = drive(state)
    noise = bands(states, asked, START_NS + 5 * S)
    assert noise is not None
    states[260] = replace(states[260], speed_mps=9.0)
    states[270] = replace(states[270], x_m=math.nan, speed_mps=math.nan)
    assert onset(states, asked, noise, START_NS + 5 * S, START_NS + 5 * S) is None
    states[261] = replace(states[261], speed_mps=9.0)
    found = onset(states, asked, noise, START_NS + 5 * S, START_NS + 5 * S)
    assert found is not None
    assert found[0].stamp_ns == states[260].stamp_ns
    # Who moves too late hasn't moved for it.
    assert onset(states, asked, noise, START_NS, START_NS + 100 * MS) is None


# -- tracking and states --------------------------------------------------------------------------


def test_tracking_errors_of_the_run_and_of_each_reference(state: StateMaker) -> None:
    def tracked(name: str, lateral: float, longitudinal: float, **given: Any) -> ObjectState:
        given = {"control_state": ControlState.RUNNING, **given}
        return state(
            "ot1",
            reference_id=name,
            error_lateral_m=lateral,
            error_longitudinal_m=longitudinal,
            **given,
        )

    states = [
        tracked("", 9.0, 9.0),
        tracked("a", 0.3, 0.0),
        tracked("a", -0.4, 1.0),
        tracked("b", 0.0, -2.0),
        tracked("b", math.nan, 0.0),
        tracked("b", 9.0, 9.0, control_state=ControlState.ABORTING),
    ]
    found = tracking(states, {"a": "approach"})
    assert found is not None
    assert (found["states"], found["not_finite"]) == (3, 1)
    assert found["lateral_rms_m"] == pytest.approx(math.sqrt(0.25 / 3), abs=1e-4)
    assert found["lateral_max_m"] == 0.4
    assert found["longitudinal_rms_m"] == pytest.approx(math.sqrt(5.0 / 3), abs=1e-4)
    assert found["longitudinal_max_m"] == 2.0
    a, b = found["by_reference"]
    assert (a["reference_id"], a["purpose"]) == ("a", "approach")
    assert (b["reference_id"], b["purpose"]) == ("b", None)
    assert a["lateral_rms_m"] == pytest.approx(math.sqrt(0.125), abs=1e-4)
    assert tracking(states[:1], {}) is None


def test_missing_and_late_states_are_counted(state: StateMaker) -> None:
    def states_of(*numbers: int) -> list[ObjectState]:
        return [state("ot1", sequence=n, stamp_ns=n * MS) for n in numbers]

    assert receipt(states_of(1, 2, 3))["lost"] == 0
    assert receipt(states_of(5, 6, 9, 10))["lost"] == 2
    assert receipt(states_of(1, 3, 2, 4)) == {"received": 4, "lost": 0, "out_of_order": 1}
    assert receipt([])["received"] == 0


# -- the whole ------------------------------------------------------------------------------------


def stamp(ns: int) -> Any:
    return SimpleNamespace(sec=ns // S, nanosec=ns % S)


def report_input(state: StateMaker, **changes: Any) -> ReportInput:
    at = START_NS + 5 * S
    firing = SimpleNamespace(
        trigger_id="gap",
        condition="gap vut - ot1 < 12 m",
        header=SimpleNamespace(stamp=stamp(at)),
        crossing_time=stamp(at - 13 * MS),
        dispatch_time=stamp(at),
        processing=0.0015,
        object_ids=["ot1"],
        reference_ids=["b"],
    )
    given: dict[str, Any] = {
        "started_ns": START_NS,
        "firings": [firing],
        "references": {"a": reference("a", START_NS, 7.0), "b": reference("b", at + 100 * MS, 5.0)},
        "acks": {"b": Acknowledgement(at + 20 * MS, "b", "ot1", True)},
        "states": {"vut": [], "ot1": drive(state, braking_from_s=5.1)},
    }
    return ReportInput(**{**given, **changes})


def test_the_way_of_a_trigger_from_the_crossing_to_the_motion(
    state: StateMaker, run: RunSpec
) -> None:
    report = report_fields(report_input(state), run)
    (fired,) = report["triggers"]
    assert (fired["crossing_s"], fired["judged_s"], fired["dispatched_s"]) == (4.987, 5.0, 5.0)
    assert fired["processing_ms"] == 1.5
    (sent,) = fired["references"]
    assert (sent["acknowledged_s"], sent["accepted"], sent["execute_at_s"]) == (5.02, True, 5.1)
    assert sent["onset"]["at_s"] == 5.12
    assert lines(report) == [
        "trigger gap: crossed at 4.987 s, judged on the state of 5.000 s, sent at 5.000 s (1.5 ms "
        "of processing); ot1: acknowledged at 5.020 s, due at 5.100 s, moved at 5.120 s "
        "(acceleration)",
        "tracking of ot1: lateral 0.000 m rms, at most 0.000 m; longitudinal 0.000 m rms, at most "
        "0.000 m; 400 states, none lost",
    ]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"acks": {}}, "ot1: no answer, due at"),
        (
            {"acks": {"b": Acknowledgement(START_NS, "b", "ot1", False, 2, "too late")}},
            "ot1: refused: too late, due at",
        ),
        ({"references": {}}, "no motion seen: the bag doesn't hold the reference"),
        (
            {"references": {"b": reference("b", START_NS, 5.0)}},
            "no motion seen: the bag doesn't hold the previous reference a",
        ),
        ({"states": {"vut": [], "ot1": []}}, "no motion seen: too few states before"),
    ],
)
def test_what_is_missing_is_said(
    state: StateMaker, run: RunSpec, changes: dict[str, Any], says: str
) -> None:
    assert says in lines(report_fields(report_input(state, **changes), run))[0]


def test_who_does_not_move_is_said(state: StateMaker, run: RunSpec) -> None:
    standing = report_input(state, states={"vut": [], "ot1": drive(state)})
    (line, _) = lines(report_fields(standing, run))
    assert line.endswith("no motion seen: no state departs from the previous reference")


def test_a_trigger_that_never_fired_is_named(state: StateMaker, run: RunSpec) -> None:
    report = report_fields(report_input(state, firings=[], states={"vut": [], "ot1": []}), run)
    assert report["tracking"] == {"ot1": None}
    assert lines(report) == ["trigger gap never fired"]


def test_a_run_without_a_bag_has_a_report(run: RunSpec, tmp_path: Path) -> None:
    said: list[str] = []
    report = measured(tmp_path / "bag", run, said.append)
    assert "is not there" in report["problem"]
    assert said == []
