"""A person's observation of a recording: bound to it, sealed, and in the words of the audit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from observation_files import NOW, answers, changed, footage_of, seal

from ssp_core.errors import InputError
from ssp_core.files.writing import write_json, write_text
from ssp_core.run_file.model import load_run
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import judge
from ssp_eval.data.audit import CONFLICT, FIELDS, MOTION, ORDER, ROLES, TOPOLOGY
from ssp_eval.observations.agreement import agree
from ssp_eval.observations.files import (
    default_place,
    find_observations,
    load_observation,
    load_observations,
    sealed_observation,
)
from ssp_eval.observations.model import Observation
from ssp_scenario_manager.event_spec.load import load_event

Bags = Callable[..., Path]


@pytest.fixture(scope="module")
def bag(bag_writer: Bags, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag_writer(tmp_path_factory.mktemp("run") / "run" / "bag")


def loaded(bag: Path, folder: Path, content: dict[str, Any], name: str = "o.json") -> Observation:
    return load_observation(seal(bag, folder / name, content), footage_of(bag))


def test_who_looks_rightly_sees_what_the_states_say_part_by_part(
    make_bag: Bags, make_task: Bags, tmp_path: Path
) -> None:
    task = make_task(lanes=2)
    bags = [
        make_bag("syn/bag", domain="synthetic"),
        make_bag("sim/bag", task=task, like_k_star=True),
        make_bag("phy/bag", domain="physical"),
    ]
    entry = judge([read_recording(b) for b in bags], load_event("cut_in")[0]).audit.recordings[1]
    lanes = load_run(task / "run.yaml").road.lanes
    oncoming = sum(lane.direction == "backward" for lane in lanes)
    content = changed("topology.lanes_opposite", oncoming)
    seen = loaded(bags[1], tmp_path, content).properties()
    for field in FIELDS:
        found, measured = seen[field].words, entry.properties[field].words
        assert found is not None
        assert measured is not None
        assert {part: list(found.get(part, ())) for part in measured} == measured, field


def test_an_observation_gives_what_the_audit_asks(bag: Path, tmp_path: Path) -> None:
    one = loaded(bag, tmp_path, changed("source_gate.identity.value", True))
    assert one.phase_starts() == {"trigger": 3.2, "conflict": 4.0, "resolution": 7.0}
    assert one.rejections() == ("identity",)
    assert one.unanswered() == ()
    assert one.visibility.participants["ot1"].share == 1.0
    assert one.visibility.conflict_region.share == 0.9
    assert one.log.safety_abort is False
    assert one.properties()[CONFLICT].words == {"paths": ("merge",)}
    assert one.properties()[CONFLICT].how == "observed by Ada Vance, frames 45"
    assert one.when.isoformat() == NOW.replace("Z", "+00:00")
    assert one.bag_sha256 == footage_of(bag).bag_sha256


@pytest.mark.parametrize(
    ("path", "field", "part"),
    [
        ("topology.lanes_opposite", TOPOLOGY, "lanes_opposite"),
        ("roles.participants.ot1.class", ROLES, "ot1"),
        ("roles.participants.ot1.starts_in", ROLES, "ot1 starts in"),
        ("roles.initiator", ROLES, "initiator"),
        ("dominant_motion.value", MOTION, "motion"),
        ("passing_order.value", ORDER, "order"),
    ],
)
def test_what_nobody_could_tell_is_not_determined(
    path: str, field: str, part: str, bag: Path, tmp_path: Path
) -> None:
    one = loaded(bag, tmp_path, changed(path, None))
    assert one.properties()[field].words is None
    assert part in one.properties()[field].how
    assert path in one.unanswered()


def test_one_lane_is_the_rightmost_and_the_leftmost(bag: Path, tmp_path: Path) -> None:
    content = changed("topology.lanes_same_direction", 1)
    content["topology"]["vut_lane"] = None
    one = loaded(bag, tmp_path, content)
    words = one.properties()[TOPOLOGY].words
    assert words is not None
    assert words["vut_lane"] == ("rightmost", "leftmost")
    assert one.unanswered() == ()


@pytest.mark.parametrize(
    ("place", "adjacency"),
    [
        ("vut_lane", "same lane"),
        ("right_lane", "adjacent lanes"),
        ("oncoming_lane", "adjacent lanes"),
        ("2_lanes_left", "lanes apart"),
        ("right_kerb", "beside the lanes"),
        ("left_road", "beside the lanes"),
    ],
)
def test_where_somebody_starts_says_how_the_lanes_lie(
    place: str, adjacency: str, bag: Path, tmp_path: Path
) -> None:
    one = loaded(bag, tmp_path, changed("roles.participants.ot1.starts_in", place))
    words = one.properties()[TOPOLOGY].words
    assert words is not None
    assert words["adjacency"] == (adjacency,)


@pytest.mark.parametrize(
    ("path", "value", "problem", "field"),
    [
        ("bag_sha256", "sha256:" + "0" * 64, "is of another recording", "bag_sha256"),
        ("conflict_type.frames", [9999], "is no frame of this recording", None),
        ("topology.frames", [[3, 9999]], "is no frame of this recording", "topology.frames[0]"),
        ("topology.frames", [[9, 3]], "ends before it begins", "topology"),
        ("topology.frames", [], "answered without evidence", "topology"),
        ("topology.frames", ["start"], "valid integer", "topology.frames[0]"),
        ("phases.resolution.t_s", 900.0, "lies outside the recording", "phases.resolution.t_s"),
        ("phases.trigger.t_s", -7.0, "lies outside the recording", "phases.trigger.t_s"),
        ("phases.conflict.t_s", 3.1, "is not after trigger.t_s at 3.2 s", "phases.conflict.t_s"),
        ("phases.start_s", 3.2, "is not after start_s", "phases.trigger.t_s"),
        ("phases.trigger.t_s", "soon", "valid number", "phases.trigger.t_s"),
        ("dominant_motion.value", "swerving", "Input should be 'stationary'", None),
        ("conflict_type.value", "collision", "Input should be 'merge'", "conflict_type.value"),
        ("topology.vut_lane", "left", "Input should be 'rightmost'", "topology.vut_lane"),
        ("topology.lanes_opposite", True, "valid integer", "topology.lanes_opposite"),
        ("roles.initiator", "ot7", "ot7 is no participant: ot1, vut", "roles.initiator"),
        ("roles.affected", "ot1", "ot1 is the initiator, too", "roles.affected"),
        ("roles.participants.ot1.role", "VUT", "one of them is the VUT", "roles.participants"),
        ("passing_order.value", ["ot1", "ot1"], "must name two of", "passing_order.value"),
        ("visibility.participants", {}, "must name ot1", "visibility.participants"),
        ("visibility.conflict_region.value", 1.5, "less than or equal to 1", None),
        ("source_gate.road.value", "no", "valid boolean", "source_gate.road.value"),
        ("who", None, "names no person", "who"),
        ("who", " ", "should match pattern", "who"),
        ("schema", "ssp.observation/9", "Input should be 'ssp.observation/1'", "schema"),
    ],
)
def test_a_wrong_observation_is_refused_with_its_field(
    path: str, value: Any, problem: str, field: str | None, bag: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as found:
        loaded(bag, tmp_path, changed(path, value))
    assert problem in found.value.problem
    assert (found.value.field or "").startswith(field or path)
    assert found.value.file == str(tmp_path / "o.json")
    assert '"seal": "' not in (tmp_path / "o.json").read_text()


@pytest.mark.parametrize(
    "path", ["topology", "topology.segment", "phases.conflict", "source_gate.road.value"]
)
def test_a_missing_answer_is_named(path: str, bag: Path, tmp_path: Path) -> None:
    content = answers()
    *before, last = path.split(".")
    place = content
    for part in before:
        place = place[part]
    del place[last]
    with pytest.raises(InputError, match="Field required") as found:
        loaded(bag, tmp_path, content)
    assert found.value.field == path


def test_a_field_that_nobody_asked_for_is_refused(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is not a known key \(got 3\); known:"):
        loaded(bag, tmp_path, {**answers(), "speed_mps": 3})


def test_what_was_changed_after_sealing_is_refused(bag: Path, tmp_path: Path) -> None:
    path = seal(bag, tmp_path / "o.json", answers())
    whole = json.loads(path.read_text())
    write_json(path, changed("phases.conflict.t_s", 4.1, whole))
    with pytest.raises(InputError, match="was changed after Ada Vance sealed it") as found:
        load_observation(path, footage_of(bag))
    assert found.value.field == "seal"
    assert found.value.value == whole["seal"]
    with pytest.raises(InputError, match="was changed after"):
        sealed_observation(path, footage_of(bag), "bag", NOW)


def test_a_sealed_file_is_not_sealed_again_nor_a_draft_believed(bag: Path, tmp_path: Path) -> None:
    path = seal(bag, tmp_path / "o.json", answers())
    with pytest.raises(InputError, match="is sealed already"):
        sealed_observation(path, footage_of(bag), "bag", NOW)
    whole = json.loads(path.read_text())
    write_json(path, {**whole, "seal": None})
    with pytest.raises(InputError, match="is a draft") as found:
        load_observation(path, footage_of(bag))
    assert "ssp audit observe BAG --seal o.json" in str(found.value)
    with pytest.raises(InputError, match="names another person than --who Bo") as found:
        sealed_observation(path, footage_of(bag), "bag", NOW, who="Bo")


def test_yaml_says_the_same_as_json(bag: Path, tmp_path: Path) -> None:
    path = seal(bag, tmp_path / "o.json", answers())
    # JSON is YAML; block style with a bare date isn't JSON.
    value = json.loads(path.read_text())
    text = yaml.safe_dump(value).replace(f"when: '{value['when']}'", f"when: {value['when']}")
    assert f"when: {value['when']}" in text
    write_text(tmp_path / "o.yaml", text)
    footage = footage_of(bag)
    assert load_observation(tmp_path / "o.yaml", footage) == load_observation(path, footage)


def test_observations_are_found_with_their_recording(bag_writer: Bags, tmp_path: Path) -> None:
    session = bag_writer(tmp_path / "run" / "bag")
    imported = bag_writer(tmp_path / "clip_bag")
    other = bag_writer(tmp_path / "other_bag", "another")
    assert find_observations(session) == []
    seal(session, default_place(session, "Ada Vance"), answers())
    seal(session, session / "observation.json", changed("who", "Bo Ek"))
    seal(imported, default_place(imported, "Ada Vance"), answers())
    assert [p.name for p in find_observations(session)] == [
        "observation.json",
        "observation_ada_vance.json",
    ]
    assert [p.name for p in find_observations(imported)] == ["clip_bag.observation_ada_vance.json"]
    assert find_observations(other) == []
    found = load_observations(session, footage_of(session))
    assert [one.who for _, one in found] == ["Bo Ek", "Ada Vance"]
    named = load_observations(other, footage_of(other), [])
    assert named == ()
    with pytest.raises(InputError, match="is of another recording"):
        load_observations(other, footage_of(other), find_observations(session))


def test_two_persons_agree_within_the_tolerance(bag: Path, tmp_path: Path) -> None:
    ada = loaded(bag, tmp_path, answers(), "a.json")
    content = changed("who", "Bo Ek")
    content = changed("phases.trigger.t_s", 3.3, content)
    content = changed("phases.conflict.t_s", 4.25, content)
    content = changed("conflict_type.value", "following", content)
    content = changed("passing_order.value", None, content)
    content = changed("visibility.conflict_region.value", 0.8, content)
    found = agree([ada, loaded(bag, tmp_path, content, "b.json")])
    assert found.by == "Ada Vance and Bo Ek"
    assert found.tolerance_s == 0.1
    assert found.answers.phase_starts() == {"trigger": pytest.approx(3.25), "resolution": 7.0}
    assert found.properties()[CONFLICT].words is None
    assert "not observed by Ada Vance and Bo Ek" in found.properties()[CONFLICT].how
    assert found.properties()[ORDER].words == {"order": ("ot1 before vut",)}
    assert found.answers.visibility.conflict_region.share == 0.8
    assert found.differing == ("conflict_type.value", "phases.conflict.t_s")
    rows = {row.field: row for row in found.rows}
    assert rows["conflict_type.value"].values == ["merge", "following"]
    assert rows["conflict_type.value"].result == "unverified"
    assert rows["passing_order.value"].verdict == "one alone"
    assert rows["phases.trigger.t_s"].result == "3.25"
    assert agree([ada], 0.5).tolerance_s == 0.5
    assert agree([ada]).properties() == ada.properties()
    assert {row.verdict for row in agree([ada]).rows} == {"one alone"}


def test_what_two_say_alone_must_fit_together(bag: Path, tmp_path: Path) -> None:
    content = changed("roles.affected", None)
    ada = loaded(bag, tmp_path, content, "a.json")
    content = changed("who", "Bo Ek", changed("roles.initiator", None))
    content = changed("roles.affected", "ot1", content)
    found = agree([ada, loaded(bag, tmp_path, content, "b.json")])
    assert found.differing == ("roles.affected",)
    assert found.properties()[ROLES].words is None


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        ("who", "ada  VANCE", "looked twice"),
        ("roles.participants.ot1.role", "OT", ""),
        ("visibility.participants", None, "name the participants by the ids"),
    ],
)
def test_observations_that_are_not_independent_or_comparable_are_refused(
    path: str, value: Any, problem: str, bag: Path, tmp_path: Path
) -> None:
    ada = loaded(bag, tmp_path, answers(), "a.json")
    content = changed("who", "Bo Ek")
    if problem.startswith("name"):
        content["roles"]["participants"]["ot2"] = content["roles"]["participants"]["ot1"]
        content["visibility"]["participants"]["ot2"] = {"value": None}
    else:
        content = changed(path, value, content)
    bo = loaded(bag, tmp_path, content, "b.json")
    if not problem:
        assert agree([ada, bo]).differing == ()
        return
    with pytest.raises(InputError) as found:
        agree([ada, bo])
    assert problem in str(found.value)


def test_observations_of_two_recordings_are_not_compared(
    bag: Path, make_bag: Bags, tmp_path: Path
) -> None:
    ada = loaded(bag, tmp_path, answers(), "a.json")
    other = make_bag("other", "another")
    bo = loaded(other, tmp_path, changed("who", "Bo Ek"), "b.json")
    with pytest.raises(InputError, match="is another recording than that of Ada Vance"):
        agree([ada, bo])
