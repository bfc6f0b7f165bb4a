"""Label proposals from ground truth: phases after METHOD 1, slots by the documented rules."""

from __future__ import annotations

import io
import json
import math
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.event import find_event, instants_of
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_eval.data.labels import Labels, labels_to_json, load_labels, parse_labels
from ssp_eval.labels.check import response_problems
from ssp_eval.labels.cli import labels as labels_command
from ssp_eval.labels.propose import propose
from ssp_eval.labels.review import is_unreviewed, sidecar, write_proposal
from ssp_eval.labels.truth import Truth, truth_from_file
from ssp_eval.recordings.event import TurnWord
from ssp_eval.recordings.geometry import motion_word, position_word
from ssp_scenario_manager.event_spec.load import load_event, seal_event, write_event
from ssp_scenario_manager.event_spec.model import Interval
from tests.support.events.audit_scenes import vut_turn
from tests.support.states import object_state as state

LANE_M = 3.5
STEP_S = 0.04


def vut(x_m: float, speed_mps: float = 10.0) -> ObjectState:
    return state("vut", ObjectClass.CAR, x_m, 0.0, 0.0, speed_mps)


def truth(series: list[tuple[float, list[ObjectState]]], target: str) -> Truth:
    return Truth(
        scenario="made_up",
        domain="simulation",
        event_version="sha256:0",
        start_s=0.0,
        end_s=series[-1][0],
        vut_id="vut",
        target_ids=(target,),
        series=series,
        source="made up",
    )


def cut_in(side: float = -1.0, vut_mps: float = 10.0, car_mps: float = 9.0) -> Truth:
    """A car in the lane on one side (-1 is right), 14 m ahead, changes lanes from 4 s to 6.5 s."""
    series = []
    for k in range(round(12.0 / STEP_S)):
        t_s = k * STEP_S
        progress = min(max((t_s - 4.0) / 2.5, 0.0), 1.0)
        rate = 0.0 if progress in (0.0, 1.0) else 1.0
        y_m = side * LANE_M * 0.5 * (1.0 + math.cos(math.pi * progress))
        left_mps = -side * rate * LANE_M * 0.5 * math.pi / 2.5 * math.sin(math.pi * progress)
        car = state(
            "ot1",
            ObjectClass.CAR,
            14.0 + car_mps * t_s,
            y_m,
            math.atan2(left_mps, car_mps),
            math.hypot(car_mps, left_mps),
        )
        series.append((t_s, [car, vut(vut_mps * t_s, vut_mps)]))
    return truth(series, "ot1")


def crossing(from_left: bool = False) -> Truth:
    """A pedestrian waits 7 m beside the VUT's path at x = 80 m and crosses from 4 s on."""
    sign = 1.0 if from_left else -1.0
    series = []
    for k in range(round(14.0 / STEP_S)):
        t_s = k * STEP_S
        walked_m = max(0.0, t_s - 4.0) * 1.5
        walking = t_s >= 4.0
        walker = state(
            "ot1",
            ObjectClass.PEDESTRIAN,
            80.0,
            sign * (7.0 - walked_m),
            -sign * math.pi / 2.0,
            1.5 if walking else 0.0,
        )
        # The VUT brakes at 3 m/s² from 5 s on, to a standstill before the pedestrian.
        braking_s = min(max(0.0, t_s - 5.0), 10.0 / 3.0)
        x_m = 10.0 * min(t_s, 5.0) + 10.0 * braking_s - 1.5 * braking_s**2
        series.append((t_s, [walker, vut(x_m, 10.0 - 3.0 * braking_s)]))
    return truth(series, "ot1")


def moved(source: Truth, by: Pose2) -> Truth:
    """The same clip somewhere else, turned."""

    def move(s: ObjectState) -> ObjectState:
        x_m, y_m = by.to_parent(s.x_m, s.y_m)
        return replace(s, x_m=x_m, y_m=y_m, yaw_rad=wrap_angle(s.yaw_rad + by.yaw_rad))

    return replace(source, series=[(t, [move(s) for s in states]) for t, states in source.series])


@pytest.mark.parametrize(("side", "word"), [(-1.0, "right"), (1.0, "left")])
def test_cut_in_phases_and_slots(side: float, word: str) -> None:
    proposal = propose(cut_in(side))
    event, labels = proposal.event, proposal.labels
    # Lateral speed passes 0.2 m/s at 4.08 s: 2.2 m/s · sin(π (t − 4) / 2.5).
    assert event.trigger_s == pytest.approx(4.08, abs=0.05)
    assert event.conflict_s is not None
    assert event.trigger_s < event.conflict_s <= event.arrival_s < 6.5
    assert labels.risk_time_s == event.trigger_s
    assert len(labels.labels) == 9
    first, last = labels.labels[0], labels.labels[-1]
    assert (first.phase, first.conflict, first.lon_actions) == (
        "approach",
        "no_conflict",
        ("maintain",),
    )
    assert (first.objects, first.position, first.motion) == (
        ("car",),
        f"front_{word}",
        "same_direction",
    )
    moving = [label for label in labels.labels if 4.2 < label.t_s < 6.2]
    assert moving
    assert {label.motion for label in moving} == {f"cutting_in_from_{word}"}
    assert last.position == "front"
    for label in labels.labels:
        assert label.risk_visible == (label.t_s >= event.trigger_s)
        if label.conflict == "active":
            assert label.lon_actions == ("stop", "decelerate")
        if label.conflict == "potential":
            assert label.lon_actions == ("decelerate", "maintain")
        assert label.lat_actions == ("straight",)
    assert response_problems(labels) == []


@pytest.mark.parametrize("from_left", [False, True])
def test_crossing_phases_and_slots(from_left: bool) -> None:
    proposal = propose(crossing(from_left))
    event, labels = proposal.event, proposal.labels
    word = "left" if from_left else "right"
    assert event.trigger_s == pytest.approx(4.0, abs=0.05)
    # Near edge at 7.0 - 0.25 m to the corridor's 1.2 m, at 1.5 m/s.
    assert event.arrival_s == pytest.approx(4.0 + (6.75 - 1.2) / 1.5, abs=0.05)
    assert event.resolution_s is not None
    before = [label for label in labels.labels if label.t_s < 4.0]
    assert {label.motion for label in before} == {"stationary"}
    assert {label.position for label in before} == {f"front_{word}"}
    walking = [label for label in labels.labels if label.t_s > 4.1]
    assert {label.motion for label in walking} == {f"crossing_from_{word}"}
    assert all(label.objects == ("pedestrian",) for label in labels.labels)
    assert response_problems(labels) == []


@settings(max_examples=10, deadline=None)
@given(
    x_m=st.floats(-1e4, 1e4),
    y_m=st.floats(-1e4, 1e4),
    yaw_rad=st.floats(-math.pi, math.pi),
    make=st.sampled_from([cut_in, crossing]),
)
def test_labels_don_t_depend_on_where_the_site_lies(
    x_m: float, y_m: float, yaw_rad: float, make: Callable[[], Truth]
) -> None:
    here = make()
    there = moved(here, Pose2(x_m, y_m, yaw_rad))
    assert propose(there).labels == propose(here).labels


def test_a_proposal_passes_the_schema() -> None:
    labels = propose(cut_in()).labels
    assert parse_labels(json.loads(json.dumps(labels_to_json(labels))), "x") == labels


def test_what_is_out_of_view_isn_t_evaluable() -> None:
    source = crossing()
    # The pedestrian stands level with the VUT, far to the side, for the whole clip but is said
    # to cross later: at the first labels nobody could see it.
    hidden = replace(source, hfov_rad=math.radians(2.0))
    labels = propose(hidden).labels.labels
    assert labels[0].objects is None
    assert labels[0].position is None
    assert labels[0].motion is None
    assert labels[0].conflict == "no_conflict"


def test_own_motion_widens_the_actions_only_without_a_conflict() -> None:
    source = cut_in()
    series = []
    for t_s, states in source.series:
        # The VUT speeds up from 7 to 11 m/s in the first 4 s.
        run_s = min(t_s, 4.0)
        x_m = 7.0 * run_s + 0.5 * run_s**2 + 11.0 * (t_s - run_s)
        speed_mps = 7.0 + run_s
        series.append((t_s, [states[0], vut(x_m, speed_mps)]))
    labels = propose(replace(source, series=series)).labels.labels
    approach = [label for label in labels if label.conflict == "no_conflict" and label.t_s <= 3.0]
    assert approach
    assert all(label.lon_actions == ("maintain", "accelerate") for label in approach)
    assert all("accelerate" not in x.lon_actions for x in labels if x.conflict == "active")


def test_no_event_and_no_conflict_are_said() -> None:
    source = cut_in()
    away = [(t_s, [replace(states[0], y_m=-20.0), states[1]]) for t_s, states in source.series]
    with pytest.raises(InputError, match="enters the VUT's corridor"):
        propose(replace(source, series=away))
    far = [
        (t_s, [replace(states[0], x_m=states[0].x_m + 300.0, speed_mps=10.0), states[1]])
        for t_s, states in source.series
    ]
    with pytest.raises(InputError, match="no conflict"):
        propose(replace(source, series=far))
    with pytest.raises(InputError, match="too short"):
        propose(replace(source, start_s=8.0))
    with pytest.raises(InputError, match="no states of the VUT"):
        propose(replace(source, vut_id="nobody"))


CORRIDOR = Corridor.of([vut(0.0), vut(100.0)])


@pytest.mark.parametrize(
    ("x_m", "y_m", "word"),
    [
        (30.0, 0.0, "front"),
        (30.0, 1.9, "front"),  # its side reaches 0.2 m into the corridor
        (30.0, LANE_M, "front_left"),
        (30.0, -LANE_M, "front_right"),
        (1.0, LANE_M, "left"),
        (1.0, -LANE_M, "right"),
        (-30.0, 0.0, "rear"),
        (-30.0, LANE_M, "rear_left"),
        (-30.0, -LANE_M, "rear_right"),
        (6.0, 15.0, "left"),  # ahead, but more than 60 degrees to the side
    ],
)
def test_position(x_m: float, y_m: float, word: str) -> None:
    other = state("ot1", ObjectClass.CAR, x_m, y_m)
    assert position_word(CORRIDOR, vut(0.0), other) == word


@pytest.mark.parametrize(
    ("y_m", "yaw_deg", "speed_mps", "word"),
    [
        (0.0, 0.0, 10.0, "same_direction"),
        (0.0, 0.0, 0.1, "stationary"),
        (0.0, 180.0, 10.0, "oncoming"),
        (LANE_M, -5.0, 10.0, "cutting_in_from_left"),
        (-LANE_M, 5.0, 10.0, "cutting_in_from_right"),
        (0.6, 5.0, 10.0, "cutting_out"),
        (0.2, 5.0, 10.0, "same_direction"),  # still in the middle of our lane
        (LANE_M, 5.0, 10.0, "same_direction"),  # further away, never in our lane
        (0.0, 0.0, 14.0, "receding"),
        (-10.0, 90.0, 3.0, "crossing_from_right"),
        (10.0, -90.0, 3.0, "crossing_from_left"),
    ],
)
def test_motion(y_m: float, yaw_deg: float, speed_mps: float, word: str) -> None:
    other = state("ot1", ObjectClass.CAR, 30.0, y_m, math.radians(yaw_deg), speed_mps)
    assert motion_word(CORRIDOR, vut(0.0), other) == word


def test_who_only_passes_behind_makes_no_event() -> None:
    source = crossing()
    ahead = [(t_s, [s[0], replace(s[1], x_m=s[1].x_m + 150.0)]) for t_s, s in source.series]
    series = [(t_s, {x.object_id: x for x in states}) for t_s, states in ahead]
    corridor = Corridor.of([states["vut"] for _, states in series])
    samples = instants_of(series, "vut", "ot1")
    assert find_event(samples, corridor.path, source.rules.thresholds) is None


def turn(rule: TurnWord | None, *, mirrored: bool = False) -> list[tuple[object, ...]]:
    """Slots of the labels up to the conflict's end, of a VUT that turns left, or its mirror image.

    Args:
        rule: to which side K* has the VUT turn; None: to none.
        mirrored: it turns right, and the other vehicle comes on its right.
    """
    found = vut_turn()
    rules = replace(found.rules, vut_turn=rule)
    series = found.series
    sign = -1.0 if mirrored else 1.0
    recorded = [
        (t_s, [replace(s, y_m=sign * s.y_m, yaw_rad=sign * s.yaw_rad) for s in states.values()])
        for t_s, states in series
    ]
    labels = propose(replace(truth(recorded, "ot1"), rules=rules)).labels.labels
    return [
        (label.position, label.motion, label.lat_actions)
        for label in labels
        if label.phase in ("trigger", "conflict")
    ]


@pytest.mark.parametrize(("side", "mirrored"), [("left", False), ("right", True)])
def test_a_turning_vut_is_given_what_it_sees_from_its_pose(side: TurnWord, mirrored: bool) -> None:
    labels = turn(side, mirrored=mirrored)
    assert labels
    assert set(labels) == {(f"front_{side}", "oncoming", ("straight", side))}


def test_a_vut_whose_road_bends_is_given_what_lies_along_it() -> None:
    """The same motions, but no turn is meant: the vehicle comes from the right of the bend."""
    labels = turn(None)
    assert labels
    assert {motion for _, motion, _ in labels} == {"crossing_from_right"}
    assert labels[0] == ("front_right", "crossing_from_right", ("straight",))


def with_spacing(labels: Labels, spacing_s: float) -> Labels:
    shifted = tuple(replace(x, t_s=k * spacing_s) for k, x in enumerate(labels.labels))
    return replace(labels, labels=shifted, risk_time_s=0.0)


def test_unattainable_risk_response_is_noticed() -> None:
    labels = propose(cut_in()).labels
    assert response_problems(with_spacing(labels, 0.6)) == []
    assert "0.7 s apart" in response_problems(with_spacing(labels, 0.7))[0]
    late = replace(labels, risk_time_s=labels.labels[-1].t_s)
    assert "needs two" in response_problems(late)[0]
    keep = tuple(replace(x, lon_actions=("maintain",)) for x in labels.labels)
    assert "admit decelerate or stop" in response_problems(replace(labels, labels=keep))[0]


def test_a_proposal_is_marked_until_it_is_edited(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    write_proposal(path, propose(cut_in()), "somewhere")
    assert is_unreviewed(path)
    path.write_text(path.read_text().replace('"maintain"', '"decelerate"'))
    assert not is_unreviewed(path)
    sidecar(path).unlink()
    assert not is_unreviewed(path)


def truth_file(source: Truth) -> dict[str, object]:
    frames = [
        {
            "t_s": t_s,
            "objects": [
                {
                    "object_id": s.object_id,
                    "object_class": s.object_class.word,
                    "role": s.role.name.lower(),
                    "x_m": s.x_m,
                    "y_m": s.y_m,
                    "yaw_rad": s.yaw_rad,
                    "speed_mps": s.speed_mps,
                    "size": {"front_m": 3.6, "rear_m": 0.9, "width_m": 1.8, "height_m": 1.5},
                }
                for s in states
            ],
        }
        for t_s, states in source.series
    ]
    return {"schema": "ssp.truth/1", "scenario": "cut_in", "frames": frames}


def test_command_line_from_a_truth_file(tmp_path: Path) -> None:
    source, out = tmp_path / "clip.truth.json", tmp_path / "labels.json"
    source.write_text(json.dumps(truth_file(cut_in())))
    run = CliRunner().invoke(labels_command, ["new", "--truth", str(source), "--out", str(out)])
    assert run.exit_code == 0, run.output
    loaded = load_labels(out)
    assert (loaded.scenario, loaded.domain, len(loaded.labels)) == ("cut_in", "synthetic", 12)
    shown = CliRunner().invoke(labels_command, ["check", str(out), "--json"])
    checked = json.loads(shown.output)
    assert checked["unreviewed"] is True
    assert checked["warnings"] == []
    again = CliRunner().invoke(labels_command, ["new", "--truth", str(source), "--out", str(out)])
    assert isinstance(again.exception, InputError)


def test_the_review_that_a_check_asks_for_can_be_pasted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = tmp_path / "clip.truth.json", tmp_path / "my labels.json"
    source.write_text(json.dumps(truth_file(cut_in())))
    assert main(["labels", "new", "--truth", str(source), "--out", str(out)]) == 0
    capsys.readouterr()
    main(["labels", "check", str(out)])
    printed = shlex.split(capsys.readouterr().err.split("`")[1])
    assert printed == ["ssp", "spec", "review", str(out), "--who", "NAME"]
    monkeypatch.setattr("sys.stdin", io.StringIO("q\n"))
    assert main(printed[1:]) == 1  # all is left


def _sized(**size: float) -> Callable[[Any], object]:
    return lambda value: value["frames"][1]["objects"][1]["size"].update(size)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_sized(front_m=-3.8), "frames[1].objects[1].size.front_m: "),
        (_sized(rear_m=51.0), "frames[1].objects[1].size.rear_m: "),
        (_sized(width_m=0.0), "frames[1].objects[1].size.width_m: "),
        (_sized(height_m=-1.0), "frames[1].objects[1].size.height_m: "),
        (_sized(front_m=0.0, rear_m=0.0), "frames[1].objects[1].size: has no length"),
        (lambda v: v.update(domain="sim"), "domain: is outside the vocabulary"),
        (lambda v: v.update(scenario=" "), "scenario: "),
        (
            lambda v: v["frames"][1]["objects"].append(v["frames"][0]["objects"][1]),
            "frames[1].objects: holds an object twice (got 'vut'); give each",
        ),
        (
            lambda v: v["frames"][2]["objects"][0].update(role="vut"),
            "frames[2].objects: holds an object as vut that was ot (got 'ot1'); give an",
        ),
        (
            lambda v: v["frames"][1]["objects"].append(
                v["frames"][0]["objects"][1] | {"object_id": "vut2"}
            ),
            "frames[1].objects: holds a second VUT beside vut (got 'vut2'); give one",
        ),
    ],
)
def test_a_truth_file_that_no_clip_has_is_refused(
    change: Callable[[Any], object], told: str, tmp_path: Path
) -> None:
    source, sound = tmp_path / "clip.truth.json", tmp_path / "sound.truth.json"
    value = truth_file(cut_in())
    sound.write_text(json.dumps(value))
    assert truth_from_file(sound).vut_id == "vut"
    value = json.loads(sound.read_text())
    change(value)
    source.write_text(json.dumps(value))
    with pytest.raises(InputError) as caught:
        truth_from_file(source)
    assert f"{source}: {told}" in str(caught.value)


@pytest.mark.parametrize(
    ("scenario", "why"),
    [('"weave", "scenario": "cut_in"', "key 'scenario' stands twice"), ("NaN", "NaN is no number")],
)
def test_a_truth_file_is_strict_json(scenario: str, why: str, tmp_path: Path) -> None:
    source, out = tmp_path / "clip.truth.json", tmp_path / "labels.json"
    text = json.dumps(truth_file(cut_in()))
    source.write_text(text.replace('"scenario": "cut_in"', f'"scenario": {scenario}'))
    run = CliRunner().invoke(labels_command, ["new", "--truth", str(source), "--out", str(out)])
    assert f"{source}: is no JSON: {why}" in str(run.exception)
    assert not out.exists()


@pytest.mark.parametrize(
    ("scenario", "more", "rule"),
    [
        ("cut_in", [], "TTC is under 3 s (the shipped K* cut_in)"),
        ("cut_in", ["--event", "cut_in"], "TTC is under 3 s (K* cut_in)"),
        ("cut_in", ["--event", "FILE"], "TTC is under 2 s (K* cut_in)"),
        (
            "weave",
            [],
            "TTC is under 2.5 s or the gap between the arrivals is under 1.5 s (no K*, "
            "the defaults: none is shipped for weave)",
        ),
        (
            "cut_in",
            ["--event-version", "sha256:1"],
            "(no K*, the defaults: the shipped cut_in is not sha256:1)",
        ),
    ],
)
def test_whose_thresholds_hold_for_a_truth_file_is_said(
    scenario: str,
    more: list[str],
    rule: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source, out = tmp_path / "clip.truth.json", tmp_path / "labels.json"
    source.write_text(json.dumps({**truth_file(cut_in()), "scenario": scenario}))
    own = tmp_path / "own.event.yaml"
    event, _ = load_event("cut_in")
    limits = event.constraints.thresholds.model_copy(
        update={"ttc": Interval(min=2.0, max=2.0, unit="s")}
    )
    constraints = event.constraints.model_copy(update={"thresholds": limits})
    write_event(own, seal_event(event.model_copy(update={"constraints": constraints})))
    given = [str(own) if word == "FILE" else word for word in more]
    assert main(["labels", "new", "--truth", str(source), "--out", str(out), *given]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert rule in said
    version = load_labels(out).event_version
    assert (version == "unknown") == (not more)
    assert ("names a K* version" in said) == (not more)


def test_command_line_refuses_what_is_no_truth(tmp_path: Path) -> None:
    source = tmp_path / "clip.truth.json"
    broken = truth_file(cut_in())
    broken["frames"][0]["objects"][0]["object_class"] = "tank"  # type: ignore[index]  # made above
    source.write_text(json.dumps(broken))
    arguments = ["new", "--truth", str(source), "--out", str(tmp_path / "labels.json")]
    run = CliRunner().invoke(labels_command, arguments)
    assert isinstance(run.exception, InputError)
    assert "tank" in str(run.exception)
