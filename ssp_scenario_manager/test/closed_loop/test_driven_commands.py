"""Driven runs by `ssp run`: their drivers, what a run leaves, how it is driven again, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.references import decode_ack, decode_reference
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_core.run_file.latency import Latency, parse_latency
from ssp_core.run_file.model import Fault, RunSpec, load_run
from ssp_core.world.driver import driver_options, model_facts
from ssp_scenario_manager.cli.run import run as run_command
from ssp_scenario_manager.closed_loop.outcomes.outcome import (
    HARNESS,
)
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS
from ssp_scenario_manager.closed_loop.single_run.before import Before, before_of_folder
from ssp_scenario_manager.closed_loop.single_run.sessions import session_summary
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import (
    run_recorded,
)
from ssp_scenario_manager.run.sweep import for_one_process

SEED = 1


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> RunSpec:
    folder = tmp_path_factory.mktemp("commands") / "cut_in"
    return prepare_run("cut_in", "boulevard", folder, seed=SEED, mode="lockstep")


@pytest.fixture(scope="module")
def start(compiled: RunSpec) -> Start:
    """A critical start of the shipped cut-in."""
    return make_start(compiled, load_event("cut_in")[0], SEED, latency_max_s=2.0)


def invoked(*arguments: str) -> Result:
    """The command's end, with its exit status as ``return_value``."""
    return CliRunner().invoke(run_command, list(arguments), standalone_mode=False)


def raised(done: Result) -> None:
    """Raise what ended a command."""
    if done.exception is not None:
        raise done.exception


def test_a_driven_run_leaves_its_bag_and_is_driven_again_from_its_folder(tmp_path: Path) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    options = ["--in-process", "--record", "--no-camera"]
    drive = ["--drive", "stop_at_once", "--latency", "fixed:0.2"]
    done = invoked("cut_in", *options, *drive, "--out", str(first))
    assert (done.exception, done.return_value) == (None, 0), done.output
    assert "stop_at_once: evaded" in done.output
    done = invoked(str(first), *options, "--seed", "2", "--out", str(again))
    assert "--seed: is settled: the folder has its start" in str(done.exception)
    done = invoked(str(first), *options, "--out", str(again))
    assert (done.exception, done.return_value) == (None, 0), done.output
    results = [json.loads((f / "result.json").read_text())["driven"] for f in (first, again)]
    assert results[0] == results[1]
    with np.load(first / "states.npz") as one, np.load(again / "states.npz") as other:
        assert all(np.array_equal(one[name], other[name]) for name in one.files)
    with BagReader(first / "bag") as bag, BagReader(again / "bag") as same:
        topics = [f"/ssp/vla/stop_at_once/{kind}" for kind in ("request", "response")]
        requests = [bag.decode(m) for m in bag.messages([topics[0]])]
        responses = [bag.decode(m) for m in bag.messages([topics[1]])]
        references = [decode_reference(m.data) for m in bag.messages(["/ssp/vut/reference"])]
        acks = [decode_ack(m.data) for m in bag.messages(["/ssp/vut/reference_ack"])]
        for topic in (*topics, "/ssp/vut/reference", "/ssp/vut/reference_ack"):
            ours = [(m.log_time_ns, m.data) for m in bag.messages([topic])]
            assert ours == [(m.log_time_ns, m.data) for m in same.messages([topic])]
    assert results[0]["answers"] == len(responses) == len(acks)
    assert {len(request.frames) for request in requests} == {0}
    assert {response.latency for response in responses} == {0.2}
    assert [array.name for array in responses[0].arrays] == ["t_s", "x_m", "y_m"]
    assert {reference.purpose for reference in references} == {"plan"}
    assert load_run(first / "run.yaml").driven == load_run(again / "run.yaml").driven
    assert sha256_file(first / "task" / "task.json") == sha256_file(again / "task" / "task.json")
    # What isn't the run of its folder any more is no valid result.
    result = json.loads((again / "result.json").read_text())
    result["driven"] |= {"outcome": "avoided", "states_sha256": "sha256:0"}
    (again / "result.json").write_text(json.dumps(result))
    done = invoked(str(again), "--in-process", "--out", str(tmp_path / "other"))
    assert (done.exception, done.return_value) == (None, 1), done.output
    other = json.loads((tmp_path / "other" / "result.json").read_text())
    assert (other["verdict"], other["driven"]["outcome"]) == ("invalid_harness", "harness")
    (reason,) = other["reasons"]
    assert reason.startswith(f"it isn't the run of {again / 'result.json'}: outcome is evaded and")
    assert "states_sha256 is sha256:" in reason
    # The picture names the outcome that is kept.
    assert f"{HARNESS} at" in (tmp_path / "other" / "top_view.svg").read_text()
    done = invoked(str(tmp_path / "other"), "--in-process", "--out", str(tmp_path / "sound"))
    assert (done.exception, done.return_value) == (None, 0), done.output
    assert f"{tmp_path / 'other'} has no sound result" in done.stderr
    (again / "result.json").write_text('{"verdict": "valid", "driven": {"chain": {}}}')
    with pytest.raises(InputError, match=r"result\.json: doesn't say what the run was"):
        raised(invoked(str(again), "--in-process", "--out", str(tmp_path / "third")))
    # A recorded session is judged by the run that it is, and by none where its states differ.
    run = load_run(first / "run.yaml")
    view = (again / "top_view.svg").read_bytes()
    (again / "top_view.svg").unlink()
    told, why = session_summary(None, None, run, again / "bag")
    assert (told["driven"], why) == (results[0], "")
    assert (again / "top_view.svg").read_bytes() == view
    changed = Before("another run", dict.fromkeys(RUN_COLUMNS, ""))
    told, why = session_summary(changed, None, run, again / "bag")
    assert (told["driven"]["outcome"], why[:11]) == (HARNESS, "it isn't th")
    assert f"{HARNESS} at" in (again / "top_view.svg").read_text()
    assert run.driven is not None
    later = run.driven.model_copy(update={"latency": Latency(0.5)})
    told, why = session_summary(None, None, run.model_copy(update={"driven": later}), again / "bag")
    assert (told["driven"]["outcome"], told["driven"]["severity"]) == ("harness", None)
    assert "aren't those of one process" in why
    assert told["driven"]["why"] == why
    # What that run can't be is refused before anything is started.
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "schema: ssp.faults/1\nfaults: [{kind: disk_full, target: monitor, at_s: 1.0}]\n"
    )
    for options in (["--mode", "realtime"], ["--faults", str(faults)]):
        refused = CliRunner().invoke(run_command, [str(first), *options])
        assert isinstance(refused.exception, InputError), refused.output
        assert "judged by the same run in one process" in str(refused.exception)


@pytest.mark.parametrize(
    ("at_s", "kind", "decided_s"), [(11.0, "fence", 11.0), (13.0, "collision", 12.84)]
)
def test_an_operators_abort_is_the_last_fact_of_a_recorded_session(
    start: Start, tmp_path: Path, at_s: float, kind: str, decided_s: float
) -> None:
    """No run in one process has it, so that the two are one and the same up to it."""
    run = for_one_process(start.driven_by("constant_velocity", {}, Latency(0.0)))
    abort = Fault(kind="operator_abort", at_s=at_s)
    aborted = run.model_copy(update={"faults": [abort]})
    (tmp_path / "run.yaml").write_text(aborted.model_dump_json(by_alias=True))
    result, _, _ = run_recorded(aborted, tmp_path / "run.yaml", tmp_path / "bag", print)
    assert result.verdict.name == "ABORTED"
    # A run file that was given without the fault tells the same.
    for spec in (run, aborted) if kind == "fence" else (run,):
        told, why = session_summary(None, None, spec, tmp_path / "bag")
        found = told["driven"]
        assert (found["outcome"], why) == (kind, ""), found["why"]
        assert found["outcome_s"] == pytest.approx(decided_s, abs=0.03)
    if kind == "fence":
        assert found["why"].startswith("abort by operator: injected fault")
    # It is held against no other run: an operator does nothing twice.
    other = Before("another run", dict.fromkeys(RUN_COLUMNS, ""))
    assert session_summary(other, None, run, tmp_path / "bag") == (told, "")
    written = {"in_process": False, "verdict": "aborted", "driven": found}
    (tmp_path / "result.json").write_text(json.dumps(written))
    assert before_of_folder(tmp_path) is None
    (tmp_path / "result.json").write_text(json.dumps(written | {"in_process": True}))
    assert before_of_folder(tmp_path) is not None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--mode", "live"], "no model drives hardware"),
        (["--mode", "realtime"], "goes with no realtime session"),
        (["--in-process", "--runs", "2"], "goes with one run"),
        (["--in-process", "--latency", "fast"], "give zero, or fixed:S"),
        (["--in-process", "--latency", "fixed:nan"], "give zero, or fixed:S"),
    ],
)
def test_a_driver_is_refused_where_it_may_not_drive(options: list[str], said: str) -> None:
    done = CliRunner().invoke(run_command, ["cut_in", "--drive", "oracle", *options])
    assert done.exit_code != 0
    assert said in done.output or said in str(done.exception)


def test_command_and_result_name_what_a_driven_run_leaves_out(
    compiled: RunSpec, tmp_path: Path
) -> None:
    assert compiled.traffic
    assert compiled.triggers[0].adaptation is not None
    first, again = tmp_path / "first", tmp_path / "again"
    done = invoked("cut_in", "--in-process", "--drive", "no_response", "--out", str(first))
    raised(done)
    assert "without traffic and adaptation, which no driven session has" in done.output
    raised(invoked(str(first), "--in-process", "--out", str(again)))
    for folder in (first, again):
        told = json.loads((folder / "result.json").read_text())
        assert told["driven"]["left_out"] == ["traffic", "adaptation"]


def test_no_run_file_lets_a_driver_drive_hardware(start: Start) -> None:
    run = start.driven_by("oracle", {}, Latency(0.0)).model_dump(mode="json", by_alias=True)
    with pytest.raises(ValueError, match="in lockstep with our own bodies only"):
        RunSpec.model_validate({**run, "mode": "live"})
    adaptation = {"first": "initiator", "gap_s": 1.0}
    triggers = [{**run["triggers"][0], "adaptation": adaptation}]
    with pytest.raises(ValueError, match="no traffic and no adaptation"):
        RunSpec.model_validate({**run, "triggers": triggers})


def test_a_latency_is_zero_fixed_or_measured() -> None:
    assert (parse_latency("zero"), parse_latency("fixed:0.25")) == (Latency(0.0), Latency(0.25))
    assert parse_latency("measured") == Latency(2.0, measured=True)
    assert parse_latency("measured:0.5") == Latency(0.5, measured=True)


@pytest.mark.parametrize(
    "text", ["fixed:-1", "fixed:1_0", "measured:0_1", "fixed:\u0662", "fixed:nan", "fixed:1e999"]
)
def test_a_latency_that_is_no_decimal_number_in_range_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is no latency"):
        parse_latency(text)


def test_a_driver_is_named_as_a_model_is_elsewhere(tmp_path: Path) -> None:
    file = tmp_path / "models.yaml"
    entry = {"backend": "http", "frames": 4, "options": {"url": "http://127.0.0.1:1"}}
    file.write_text(yaml.safe_dump({"schema": "ssp.models/1", "models": {"mine": entry}}))
    assert driver_options("mine", {}, file) == {"model": entry}
    inline = driver_options("mine", {"backend": "http", "url": "http://127.0.0.1:1"})
    assert inline == {"model": {"backend": "http", "options": {"url": "http://127.0.0.1:1"}}}
    assert driver_options("mine", inline) == inline
    assert driver_options("aeb", {"ttc_s": 1.4}) == {"ttc_s": 1.4}


def test_what_a_card_says_of_a_model_is_what_its_driver_does() -> None:
    entry = {"backend": "http", "frames": 4, "weights_sha256": "sha256:1"}
    service = {"url": "http://127.0.0.1:1", "timeout_s": 3.0}
    told = model_facts("mine", driver_options("mine", {"model": {**entry, "options": service}}))
    assert str(told.pop("prompt_sha256")).startswith("sha256:")
    assert told == {
        "model": "http",
        "prompt": "task and prompt of the request",
        "weights_sha256": "sha256:1",
        "interface": "waypoints",
        "adapter": "waypoints:ego_xy",
        "frames": 4,
        "frame_spacing_s": 0.1,
        "history_s": 2.0,
        "timeout_s": 3.0,
        "sees_route": False,
    }


@pytest.mark.parametrize(
    ("name", "given", "said"),
    [
        ("nobody", {}, r"is no driver.*oracle.*NAME=.*openai"),
        ("perfect", {}, "answers from labels, and a driver gets none"),
        ("mine", {"backend": "http", "adress": "x"}, "adress"),
        ("openai", {"model": "m", "centre_line": True}, "centre_line.*no place for the centre"),
        ("mine", {"backend": "http", "url": "http://a", "centre_line": 1}, "centre_line"),
        ("mine", {"backend": "http", "url": "http://a", "api_key": "x"}, "is a secret's place"),
        ("oracle", {"backend": "http"}, "oracle"),
        (
            "mine",
            {"attached": True},
            r"mine\.attached.*already running.*\"backend\": \"node\", \"topic\".*or end it",
        ),
    ],
)
def test_a_driver_that_can_not_be_is_refused_with_what_there_is(
    name: str, given: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        driver_options(name, given)
