"""The interaction graph adds nothing of its own; picture, check and diff on the command line."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ssp_core.cli import main
from ssp_scenario_manager.event_spec.fields import get, has, show
from ssp_scenario_manager.event_spec.graph import differences, interaction_graph
from ssp_scenario_manager.event_spec.load import body, load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.event_spec.picture import picture
from ssp_scenario_manager.maps.site import find_shipped
from ssp_scenario_manager.scenarios.events.kinds import KINDS

NAMES = tuple(sorted(KINDS))


@pytest.fixture(params=NAMES)
def event(request: pytest.FixtureRequest) -> Event:
    return load_event(request.param)[0]


def test_every_node_and_edge_says_what_the_event_says(event: Event) -> None:
    graph, value = interaction_graph(event), body(event)
    names = {node["id"] for node in graph["nodes"]}
    assert len(names) == len(graph["nodes"])
    for item in (*graph["nodes"], *graph["edges"]):
        assert item["fields"]
        for path, said in item["fields"].items():
            assert get(value, path) == said
    for edge in graph["edges"]:
        assert {edge["from"], edge["to"]} <= names
    assert {edge["kind"] for edge in graph["edges"]} == {"spatial", "temporal", "interaction"}


def test_graph_holds_all_types_and_relations_of_the_method(event: Event) -> None:
    graph = interaction_graph(event)
    types = {node["type"] for node in graph["nodes"]}
    assert {"road", "lane", "VUT", "OT", "conflict_zone", "phase"} <= types
    relations = {edge["relation"] for edge in graph["edges"]}
    wanted = {"occupies", "ahead-of", "path-intersects", "before"}
    wanted |= {"triggers", "changes-motion", "exposes-conflict", "responds"}
    assert wanted <= relations
    assert ("adjacent" in relations) == (KINDS[event.name].relation != "following")


def test_determined_and_uncertain_values_come_from_the_event(event: Event) -> None:
    graph, value = interaction_graph(event), body(event)
    end_s = {"roundabout": 17.0, "vut_turn": 10.5}.get(event.name, 9.0)
    assert graph["determined"]["events.clip.end"] == {"value": end_s, "unit": "s"}
    assert "constraints.trigger.below" not in graph["determined"]
    uncertain = graph["uncertain"]["constraints.trigger.below"]
    assert uncertain["value"] == get(value, "constraints.trigger.below")
    assert uncertain["known"]["review"] == "accepted"
    for path in (*graph["determined"], *graph["uncertain"]):
        assert has(value, path)


def test_graph_changes_with_the_event_and_only_with_it(event: Event) -> None:
    turned = event.interaction.model_copy(update={"passing_order": ["vut", "ot1"]})
    before = [e for e in interaction_graph(event)["edges"] if e["relation"] == "before"][-1]
    after = interaction_graph(event.model_copy(update={"interaction": turned}))["edges"]
    changed = [e for e in after if e["relation"] == "before"][-1]
    assert (before["from"], before["to"]) == (changed["to"], changed["from"])


def test_picture_is_svg_that_names_everybody_and_every_speed(event: Event) -> None:
    root = ElementTree.fromstring(picture(event))
    words = {element.text for element in root.iter() if element.text}
    assert set(event.participants) <= {word.partition(",")[0] for word in words}
    for phases in event.constraints.speeds.values():
        for speed in phases.values():
            assert not isinstance(speed, str)
            assert show(speed.model_dump()) in words
    width, height = float(root.attrib["width"]), float(root.attrib["height"])
    for element in root.iter("{http://www.w3.org/2000/svg}text"):
        assert 0 < float(element.attrib["x"]) <= width
        assert 0 < float(element.attrib["y"]) <= height


def test_what_comes_the_other_way_faces_the_vut_and_moves_by_its_sides() -> None:
    drawn = {name: picture(load_event(name)[0]) for name in ("oncoming_turn", "cut_in")}
    assert "↱ to the VUT's right" in unescape(drawn["oncoming_turn"])
    assert "↱ to the VUT's" not in unescape(drawn["cut_in"])
    # The windscreen lies on the side of a body's middle, at 156 and 596, that is its front.
    sides = {}
    for name, text in drawn.items():
        found = re.findall(r'<rect x="([0-9.]+)" y="[0-9.]+" width="9.24"', text)
        sides[name] = [float(x) > at for x, at in zip(found, (156.0, 596.0), strict=True)]
    assert sides == {"oncoming_turn": [True, False], "cut_in": [True, True]}


def test_picture_escapes_what_people_write(event: Event) -> None:
    text = "<script>alert('x')</script> & more"
    root = ElementTree.fromstring(picture(event.model_copy(update={"description": text})))
    assert text in {element.text for element in root.iter()}


def test_graph_command_writes_both_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["spec", "graph", "cut_in", "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "out" / "cut_in.graph.json").read_text())
    assert (tmp_path / "out" / "cut_in.graph.svg").read_text().startswith("<svg")
    assert main(["spec", "graph", "cut_in"]) == 0
    assert "ot1 —path-intersects→ vut" in capsys.readouterr().out


def test_graph_command_writes_the_one_file_that_is_named(tmp_path: Path) -> None:
    for name in ("new/a.svg", "a.json"):
        assert main(["spec", "graph", "cut_in", "--out", str(tmp_path / name)]) == 0
    assert {path.name for path in tmp_path.rglob("*.*")} == {"a.svg", "a.json"}
    assert main(["spec", "graph", "cut_in", "--out", str(tmp_path / "a.png")]) == 2


def test_graph_command_replaces_files_by_force_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["spec", "graph", "cut_in", "--out", str(tmp_path)]
    mine = tmp_path / "cut_in.graph.svg"
    mine.write_text("mine")
    assert main(words) == 1
    assert f"{mine}: exists already; another --out, or --force" in capsys.readouterr().err
    assert [file.read_text() for file in tmp_path.iterdir()] == ["mine"]
    assert main([*words, "--force"]) == 0
    assert mine.read_text().startswith("<svg")


@pytest.mark.parametrize("command", ["graph", "diff"])
def test_every_error_of_the_form_is_named(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "empty.event.yaml"
    file.write_text("schema: ssp.event/2\n")
    others = {"graph": [], "diff": ["cut_in"]}
    assert main(["spec", command, str(file), *others[command]]) == 1
    error = capsys.readouterr().err
    assert "errors:" in error
    assert " more)" not in error
    assert all(f"\n  {name}: Field required" in error for name in ("name", "topology"))


def test_graph_command_says_that_checks_fail(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = _changed(tmp_path, "lateral: right", "lateral: left")
    assert main(["spec", "graph", str(file)]) == 0
    assert "checks don't hold" in capsys.readouterr().err


def test_check_command_reports_every_file_and_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = _changed(tmp_path, "class: car", "class: cyclist", "below: {min: 16", "below: {min: 160")
    assert main(["spec", "check", "vru_crossing"]) == 0
    assert capsys.readouterr().out.startswith("ok")
    assert main(["spec", "check", "vru_crossing", str(file), "--json"]) == 1
    good, bad = json.loads(capsys.readouterr().out)
    assert (good["ok"], good["version"]) == (True, load_event("vru_crossing")[1])
    assert not bad["ok"]
    assert bad["version"] is not None
    found = {(item["check"], item["field"]) for item in bad["failures"]}
    assert ("C1", "participants.vut.class") in found
    assert ("C5", "constraints.trigger.below.min") in found
    assert ("review", "constraints.trigger.below") in found
    assert all(set(item) >= {"evidence", "reason", "origin", "remedy"} for item in bad["failures"])
    assert main(["spec", "check", str(file)]) == 1
    shown = capsys.readouterr().out
    for name in ("evidence", "reason", "origin", "remedy", "participants.vut.class"):
        assert name in shown


def test_a_file_of_a_wrong_form_has_no_version(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = _changed(tmp_path, "class: car", "class: tram")
    assert main(["spec", "check", str(file), "--json"]) == 1
    (report,) = json.loads(capsys.readouterr().out)
    assert report["version"] is None
    assert {item["check"] for item in report["failures"]} == {"form"}


def test_origin_follows_the_provenance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = find_shipped("cut_in", "event").read_text()
    for provenance, origin in (("frame", "source video"), ("model", "extraction")):
        file = tmp_path / f"{provenance}.event.yaml"
        changed = text.replace("vut_lane: {value: rightmost", "vut_lane: {value: outermost")
        changed = changed.replace(
            "confidence: 0.95, provenance: frame", f"confidence: 0.95, provenance: {provenance}"
        )
        file.write_text(changed)
        assert main(["spec", "check", str(file), "--json"]) == 1
        (report,) = json.loads(capsys.readouterr().out)
        (failure,) = [f for f in report["failures"] if f["field"] == "topology.vut_lane.value"]
        assert failure["origin"] == origin
        assert "rightmost" in failure["remedy"]


def test_diff_shows_field_old_new_and_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = _changed(
        tmp_path, "below: {min: 16", "below: {min: 17", "lateral: right", "lateral: left"
    )
    assert main(["spec", "diff", "cut_in", str(file), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    by_field = {item["field"]: item for item in report["differences"]}
    assert set(by_field) == {
        "constraints.trigger.below",
        "motion.ot1.trigger.lateral",
        "motion.ot1.conflict.lateral",
    }
    below = by_field["constraints.trigger.below"]
    assert (below["old"]["min"], below["new"]["min"], below["unit"]) == (16, 17, "m")
    assert main(["spec", "diff", "cut_in", str(file)]) == 1
    assert "- 16–20 m" in capsys.readouterr().out


def test_diff_of_the_same_content_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = _changed(tmp_path, "[decelerate, stop]", "[stop, decelerate]")
    assert main(["spec", "diff", "cut_in", str(file)]) == 0
    assert load_event("cut_in")[1] in capsys.readouterr().out


def test_diff_names_fields_that_one_side_lacks() -> None:
    first, second = load_event("vru_crossing")[0], load_event("occluded_crossing")[0]
    found = {item.field: item for item in differences(first, second)}
    assert found["participants.ot2.role"].where == "second"
    assert found["constraints.manoeuvre.occluder_gap"].old is None
    assert found["uncertainty.participants.ot2.role"].where == "second"
    back = {item.field: item for item in differences(second, first)}
    assert set(back) == set(found)
    assert back["participants.ot2.role"].where == "first"


def _changed(folder: Path, *pairs: str) -> Path:
    """A copy of cut_in with words replaced."""
    text = find_shipped("cut_in", "event").read_text()
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text
        text = text.replace(old, new)
    file = folder / "changed.event.yaml"
    file.write_text(text)
    return file
