"""``ssp score`` as people and programs call it."""

import json
import math
from dataclasses import asdict, fields

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.score.metrics import METRIC_NAMES
from ssp_eval.score.thresholds import DEFAULT, Thresholds, ThresholdsFile, thresholds_of

KEYS = ["n", "matched", *METRIC_NAMES, "denominators"]
NAMES = ("objects", "position", "motion", "conflict", "lon_action", "lat_action")


def label(t_s):
    return {
        "t_s": t_s,
        "phase": "conflict",
        "risk_visible": True,
        "objects": ["car"],
        "position": "front",
        "motion": "same_direction",
        "conflict": "active",
        "lon_actions": ["decelerate"],
        "lat_actions": ["straight"],
    }


def record(t_s, text="slow down for the car"):
    values = (["car"], "front", "same_direction", "active", "decelerate", "straight")
    return {
        "schema": "ssp.record/1",
        "t_s": t_s,
        "text": text,
        "slots": {
            name: {"value": value, "evidence": [[0, 4]]}
            for name, value in zip(NAMES, values, strict=True)
        },
        "trajectory": {"t_s": [0.0, 0.5, 1.0], "x_m": [0.0, 5.0, 9.0], "y_m": [0.0] * 3},
        "invalid": [],
    }


@pytest.fixture
def make_case(tmp_path):
    """Writes a folder with labels at 1.0 and 1.5 s and the records given."""

    def make(name, records=(), **labels):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        content = {
            "schema": "ssp.labels/1",
            "scenario": "cut_in",
            "domain": "physical",
            "event_version": "v",
            "risk_time_s": 0.75,
            "first_frame_dynamics": True,
            "labels": [label(1.0), label(1.5)],
        } | labels
        (folder / "labels.json").write_text(json.dumps(content))
        lines = [item if isinstance(item, str) else json.dumps(item) for item in records]
        (folder / "records.jsonl").write_text("".join(f"{line}\n" for line in lines))
        return folder

    return make


@pytest.fixture
def run(capsys):
    """Runs ``ssp score`` and returns status, standard output, standard error."""

    def call(*args):
        capsys.readouterr()
        status = main(["score", *map(str, args)])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


def test_json_gives_one_line_per_folder_sorted_by_name(make_case, run):
    perfect = make_case("b_perfect", [record(1.0), record(1.5)])
    silent = make_case("a_silent")
    status, out, _ = run(perfect, silent, "--json")
    assert status == 0
    first, second = map(json.loads, out.splitlines())
    assert list(first) == ["case", *KEYS, "thresholds_sha256"]
    assert (first["case"], second["case"]) == ("a_silent", "b_perfect")
    assert (first["ivcs"], first["rl_s"], first["sem_acc_cond"]) == (0.0, None, None)
    assert (second["ivcs"], second["rl_s"]) == (1.0, 0.25)
    assert second["denominators"] == {"semantic": 8, "cia": 2}
    assert second["thresholds_sha256"] == DEFAULT.sha256


def test_json_keeps_full_double_precision(make_case, run):
    folder = make_case("thirds", [record(1.0)], labels=[label(1.0), label(1.5), label(2.0)])
    assert json.loads(run(folder, "--json")[1])["jovr"] == 1 / 3


def test_the_table_shows_response_nulls_and_the_disclaimer(make_case, run):
    nothing = dict.fromkeys(("objects", "position", "motion", "conflict"))
    folders = [
        make_case("late", [record(1.0), record(1.5), record(9.0)]),
        make_case("[red]null", [record(1.0)], labels=[label(1.0) | nothing]),
    ]
    status, out, _ = run(*folders)
    rows = {line.split("│")[1].strip(): line for line in out.splitlines() if line.startswith("│")}
    assert status == 0
    assert "S@0.25" in rows["late"]
    assert " F " in rows["[red]null"]
    assert "–" in rows["[red]null"]
    assert "0.400*" in rows["[red]null"]
    assert "IVCS is no safety certificate" in out
    assert "no denominator for sem_acc_eff, cia_eff, counted as 0 in IVCS" in out
    assert "late: records that match no label, ignored: 1." in out
    assert "…" not in out


def test_folders_that_share_a_name_are_told_apart_by_their_paths(make_case, run):
    folders = [make_case(f"{parent}/same") for parent in ("x", "y")]
    _, out, _ = run(*reversed(folders), "--json")
    assert [json.loads(line)["case"] for line in out.splitlines()] == [str(f) for f in folders]


def test_the_name_of_the_present_folder_is_found(make_case, run, monkeypatch):
    monkeypatch.chdir(make_case("here"))
    assert json.loads(run(".", "--json")[1])["case"] == "here"


def test_labels_in_yaml_are_found_and_two_labels_files_are_refused(make_case, run):
    folder = make_case("case")
    (folder / "labels.json").rename(folder / "labels.yaml")
    assert run(folder, "--json")[0] == 0
    (folder / "labels.json").write_text("{}")
    status, out, err = run(folder, "--json")
    assert (status, out) == (1, "")
    assert "labels.json, labels.yaml" in err


@pytest.mark.parametrize(
    ("records", "labels", "expected"),
    [
        ([record(1.0), "{"], {}, "records.jsonl:2: is not valid JSON"),
        (
            [json.dumps(record(1.0))[:-1] + ', "t_s": 2.0}'],
            {},
            "records.jsonl:1: t_s: stands twice in an object; keep one of the two",
        ),
        ([record(1.0), record(1.0)], {}, "records.jsonl:2: t_s: must rise strictly"),
        ([record(math.nan)], {}, "records.jsonl:1: t_s: Input should be a finite number"),
        ([record(1.0) | {"text": 3}], {}, "records.jsonl:1: text: Input should be a valid string"),
        ([record(1.0) | {"schema": "x"}], {}, "records.jsonl:1: schema: Input should be"),
        ([], {"domain": "moon"}, "labels.json: domain: is outside the vocabulary"),
        ([], {"labels": []}, "labels.json: labels: Tuple should have at least 1"),
        (
            [],
            {"labels": [label(1.0) | {"lon_actions": []}]},
            "labels.json: labels[0].lon_actions: Tuple should have at",
        ),
        (
            [],
            {"labels": [label(1.0) | {"risk_visible": False}], "risk_time_s": None},
            "labels.json: risk_time_s: is null",
        ),
    ],
)
@pytest.mark.parametrize("form", [["--json"], []])
def test_one_bad_file_means_that_nothing_is_scored(make_case, run, records, labels, expected, form):
    good = make_case("a_good", [record(1.0), record(1.5)])
    bad = make_case("b_bad", records, **labels)
    status, out, err = run(good, bad, *form)
    assert (status, out) == (1, "")
    assert f"{bad}/{expected}" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("missing", ["labels.json", "records.jsonl"])
def test_a_missing_file_is_named(make_case, run, missing):
    folder = make_case("case")
    (folder / missing).unlink()
    status, out, err = run(folder, "--json")
    assert (status, out) == (1, "")
    assert f"{folder}/{missing}: can't be read" in err


def test_a_missing_folder_is_named(tmp_path, run):
    status, out, err = run(tmp_path / "nowhere", "--json")
    assert (status, out) == (1, "")
    assert "nowhere: is not there; give folders with labels and records" in err


@pytest.mark.parametrize("args", [[], ["--json"], ["--yaml", "x"]])
def test_wrong_usage_exits_with_2(run, args):
    status, out, _ = run(*args)
    assert (status, out) == (2, "")


def test_no_record_at_all_is_noted_beside_the_result(make_case, run):
    status, out, err = run(make_case("full", [record(1.0)]), make_case("empty"), "--json")
    assert status == 0
    assert [json.loads(line)["matched"] for line in out.splitlines()] == [0, 1]
    note = "note: empty: records.jsonl holds no record; every output is missing"
    assert err.splitlines() == [note]


def thresholds_in(folder, text):
    file = folder / "thresholds.yaml"
    file.write_text(f"schema: ssp.thresholds/1\n{text}")
    return file


def test_thresholds_of_a_file_count_and_are_told(make_case, run, tmp_path):
    """One answer is a response where K is 1, and far from its label it matches within 0.3 s."""
    case = make_case("one", [record(1.25)])
    strict = json.loads(run(case, "--json")[1])
    assert (strict["matched"], strict["rsr"]) == (0, 0)
    file = thresholds_in(tmp_path, "match_window_s: 0.3\nresponse_count: 1\ntolerance: 1e-9\n")
    status, out, err = run(case, "--json", "--thresholds", file)
    found = json.loads(out)
    assert (status, found["matched"], found["rsr"], found["rl_s"]) == (0, 1, 1, 0.5)
    assert found["thresholds_sha256"] == Thresholds(match_window_s=0.3, response_count=1).sha256
    told = " ".join(err.split())
    assert "scored with other thresholds than METHOD's: match_window_s 0.3 (METHOD: 0.11)" in told
    assert "response_count 1 (METHOD: 2)" in told
    same = thresholds_in(tmp_path, "match_window_s: 0.11\n")
    status, out, err = run(case, "--json", "--thresholds", same)
    assert (json.loads(out), err) == (strict, "")


@pytest.mark.parametrize(
    ("text", "field", "told"),
    [
        ("match_window: 0.2\n", "match_window", "known"),
        ("weight_jovr: 0.2\n", "weight_jovr", "the weights of IVCS are METHOD 6.10's"),
        ("response_count: 0\n", "response_count", "1"),
        ("response_count: 1.5\n", "response_count", "integer"),
        ("response_count: true\n", "response_count", "true and false are none"),
        ("match_window_s: -0.1\n", "match_window_s", "0"),
        ("stop_speed_mps: .nan\n", "stop_speed_mps", ""),
        ("soft_credit: 1.5\n", "soft_credit", "1"),
        ("stop_speed_mps: fast\n", "stop_speed_mps", "number"),
    ],
)
def test_wrong_thresholds_name_file_field_and_remedy(make_case, run, tmp_path, text, field, told):
    file = thresholds_in(tmp_path, text)
    status, out, err = run(make_case("one", [record(1.0)]), "--thresholds", file)
    assert (status, out) == (1, "")
    told_err = " ".join(err.split())
    assert f"thresholds.yaml: {field}" in told_err
    assert told in told_err


def test_a_file_of_thresholds_can_give_each_of_them():
    named = {field.name for field in fields(Thresholds) if not field.name.startswith("weight_")}
    assert ThresholdsFile.model_fields.keys() - {"schema_"} == named
    assert thresholds_of(asdict(DEFAULT), "cell.json") == DEFAULT
    with pytest.raises(InputError, match="names other thresholds"):
        thresholds_of({**asdict(DEFAULT), "more": 1.0}, "cell.json")
