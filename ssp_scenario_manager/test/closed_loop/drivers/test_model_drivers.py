"""Models as drivers in one process: what they get, and what becomes of those that misbehave."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from click.testing import CliRunner, Result

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import Camera, Fault, RunSpec, load_run
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import (
    Answer,
    GivenAnswer,
    LatencyParts,
    Question,
    driver_options,
    model_facts,
    try_driver,
)
from ssp_core.world.driver_answers import NODE_ANSWERS_FILE, append_answer
from ssp_ot_controller.driving import baselines
from ssp_ot_controller.driving.baselines import lane_plan
from ssp_ot_controller.driving.frames import QuestionFrames
from ssp_scenario_manager.cli.run import run as run_command
from ssp_scenario_manager.closed_loop.answers import answers_of
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver
from ssp_scenario_manager.closed_loop.campaigns.runs import Job, rows_of
from ssp_scenario_manager.closed_loop.outcomes.outcome import Outcome, driven_summary, outcome_of
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS
from ssp_scenario_manager.closed_loop.single_run import single
from ssp_scenario_manager.closed_loop.single_run.sessions import session_summary
from ssp_scenario_manager.closed_loop.single_run.single import Drive, parse_drive
from ssp_scenario_manager.closed_loop.single_run.top_view import top_view
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import EVENT_FILE, TASK_FILE, TASK_FOLDER
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import (
    InProcessResult,
    Record,
    run_in_process,
    run_recorded,
)
from ssp_scenario_manager.run.sweep import for_one_process
from ssp_scenario_manager.session import outbox

SEED = 1
# Pictures cost nothing at this size.
SMALL = Camera(width_px=64, height_px=64)

MODEL = '''
import os
import time

import numpy as np

ASKED = []


def points(request):
    v = request.history[-1].speed_mps
    return [(0.5 * v * k, 0.0) for k in range(11)]


def keep(request):
    return "I keep my speed.", points(request)


def count(request):
    """Say how often it was asked in its process, and what it was shown."""
    ASKED.append(request)
    ages = [request.stamp_ns - frame.stamp_ns for frame in request.frames]
    first = request.history[0].t_s
    return f"{len(ASKED)} {ages} {first:.2f} {request.camera.width_px}", points(request)


def route(request):
    """Say what it gets of the centre line of its lane."""
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in request.route_m), points(request)


def late(request):
    return request.stamp_ns > 8_500_000_000


def hang(request):
    while late(request):
        time.sleep(60.0)
    return keep(request)


def leave(request):
    if late(request):
        os._exit(3)
    return keep(request)


def kill(request):
    if late(request):
        os.kill(os.getpid(), 9)
    return keep(request)


def fail(request):
    if late(request):
        raise RuntimeError("CUDA out of memory")
    return keep(request)


def fast(request):
    return "I hurry.", [(8.5 * k, 0.0) for k in range(11)]


def no_numbers(request):
    return "nan", [(float("nan"), 0.0)] * 11


def backwards(request):
    return "back", [(-x, y) for x, y in points(request)]


def far_away(request):
    return "far", [(x + 10_000.0, y) for x, y in points(request)]


def long(request):
    return "x" * (3 << 20), points(request)


def nothing(request):
    return ""


def no_plan(request):
    """Answer by turns what is no plan."""
    turns = (no_numbers, backwards, far_away, long, nothing)
    ASKED.append(request)
    return turns[len(ASKED) % len(turns)](request)
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("model")
    (made / "driving_models.py").write_text(MODEL)
    return made


@pytest.fixture(scope="module")
def compiled_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the compiled cut-in once there is a start of it."""
    return tmp_path_factory.mktemp("driven") / "cut_in"


@pytest.fixture(scope="module")
def start(compiled_folder: Path) -> Start:
    """A critical start of the shipped cut-in, with a camera of few pixels."""
    compiled = prepare_run("cut_in", "boulevard", compiled_folder, seed=SEED, mode="lockstep")
    small = compiled.model_copy(update={"camera": SMALL})
    return make_start(small, load_event("cut_in")[0], SEED, latency_max_s=0.5)


def python(folder: Path, name: str, **given: Any) -> dict[str, Any]:
    function = f"driving_models:{name}"
    return {"backend": "python", "function": function, "folder": str(folder), **given}


def driven_run(start: Start, options: dict[str, Any], latency_s: float = 0.0) -> RunSpec:
    return start.driven_by("mine", driver_options("mine", options), Latency(latency_s))


def drive(run: RunSpec, start: Start) -> tuple[Outcome, InProcessResult, Record]:
    result, record = run_in_process(run)
    assert run.driven is not None
    return outcome_of(run, run.driven, result, record, start.twin), result, record


def answers(record: Record) -> list[Answer]:
    drives = [report.drive for report in record.reports if report.drive is not None]
    return [one.effective_answer.answer for one in drives if one.effective_answer is not None]


def test_a_model_drives_by_the_frames_and_the_motion_of_its_interface(
    start: Start, folder: Path
) -> None:
    run = driven_run(start, python(folder, "count"), latency_s=0.2)
    outcome, result, record = drive(run, start)
    assert (outcome.kind, result.verdict.name) == ("collision", "VALID"), outcome
    assert start.contact is not None
    assert abs(outcome.contact.relative_mps - start.contact.relative_mps) < 0.05  # type: ignore[union-attr]
    said = [answer.text for answer in answers(record)]
    assert [text.split()[0] for text in said] == [str(k) for k in range(1, len(said) + 1)]
    ages = [k * 100_000_000 for k in range(9, -1, -1)]
    assert said[-1].split(" ", 1)[1] == f"{ages} -2.00 64"
    asked = [r.drive.question for r in record.reports if r.drive is not None and r.drive.question]
    assert all(question.frames[-1].stamp_ns == question.stamp_ns for question in asked)
    assert asked[0].stamp_ns == round(start.first_request_s * 1e9)


def test_a_model_is_given_the_centre_line_of_its_lane_where_its_entry_says_so(
    start: Start, folder: Path
) -> None:
    """The line reaches at most 80 m ahead, and the model's card says so."""
    with_line = python(folder, "route", centre_line=True)
    for options, sees in ((python(folder, "route"), False), (with_line, True)):
        given = driver_options("mine", options)
        assert model_facts("mine", given)["sees_route"] is sees
        said = answers(drive(driven_run(start, options, latency_s=0.5), start)[2])[0].text
        places = [tuple(map(float, one.split(","))) for one in said.split()]
        expected = [(1.0 * k, 0.0) for k in range(81)] if sees else []
        assert len(places) == len(expected)
        assert np.allclose(np.array(places), np.array(expected), atol=0.1)


def test_each_run_has_a_fresh_model(start: Start, folder: Path) -> None:
    """A memory of the run before would tell it the event-free twin."""
    run = driven_run(start, python(folder, "count"), latency_s=0.5)
    first, second = (answers(drive(run, start)[2]) for _ in range(2))
    assert first[0].text.split()[0] == second[0].text.split()[0] == "1"
    assert first == second


@pytest.mark.parametrize(
    ("function", "why"),
    [
        ("leave", "its process ended with exit status 3"),
        ("kill", "its process was ended by SIGKILL"),
        ("fail", "RuntimeError: CUDA out of memory"),
        ("hang", "gave no answer within its timeout_s of 0.2 s"),
    ],
)
def test_a_model_that_fails_has_its_outcome_and_its_reason(
    start: Start, folder: Path, function: str, why: str
) -> None:
    given = {"timeout_s": 0.2} if function == "hang" else {}
    run = driven_run(start, python(folder, function, **given), latency_s=0.5)
    outcome, result, _ = drive(run, start)
    assert outcome.kind == "died", outcome
    assert why in outcome.why
    assert result.verdict.name != "NONE"


def test_answers_that_are_no_plans_have_their_reasons_and_avoid_nothing(
    start: Start, folder: Path
) -> None:
    run = driven_run(start, python(folder, "no_plan"), latency_s=0.5)
    outcome, result, record = drive(run, start)
    assert outcome.kind in ("evaded", "fallback"), outcome
    assert result.verdict.name != "NONE"
    refused = {
        r.drive.effective_answer.refused
        for r in record.reports
        if r.drive and r.drive.effective_answer
    }
    for reason in (
        "non_finite",
        "goes back by",
        "10000.0 m away from the vehicle",
        "characters and 22 numbers, at most 1048576",
        "not_ready",
    ):
        assert any(reason in text for text in refused), (reason, refused)


def test_a_model_that_can_not_be_loaded_ends_one_run_and_is_refused_by_a_command(
    start: Start, folder: Path
) -> None:
    options = python(folder, "is_not_there")
    run = driven_run(start, options)
    outcome, _, record = drive(run, start)
    assert outcome.kind == "died"
    assert outcome.why.startswith("it can't be loaded")
    assert run.driven is not None
    # The view from above shows no plan, where there is none.
    assert "<svg" in top_view(
        run, record, driven_summary(run.driven, record, outcome, None), outcome.contact
    )
    with pytest.raises(
        InputError, match=r"driver mine: can't be loaded: backend_options.*is_not_there"
    ):
        try_driver("mine", parse_drive(f"mine={json.dumps(options)}", "zero").options)


def test_a_failed_run_drops_no_campaign_and_the_next_has_a_fresh_model(
    start: Start, folder: Path
) -> None:
    sealed = {"event": "cut_in", "kind": "critical", **start.sealed()}
    options = driver_options("mine", python(folder, "leave"))
    driver = CampaignDriver(driver="mine", options=options)
    rows = rows_of(Job(json.dumps(sealed), driver, (Latency(0.0), Latency(0.5)), 1, SEED)).rows
    kinds = [row[RUN_COLUMNS.index("outcome")] for row in rows]
    reasons = {row[RUN_COLUMNS.index("why")] for row in rows}
    assert (kinds, reasons) == (["died"] * 2, {"its process ended with exit status 3"})


# -- freshness -------------------------------------------------------------------------------------


def _frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera goes on to show its first picture, under new stamps."""
    show, kept = QuestionFrames.show, []

    def frozen(self: QuestionFrames, indices: Any) -> Any:
        frames = show(self, indices)
        kept.append(frames[-1].jpeg)
        return tuple(replace(frame, jpeg=kept[0]) for frame in frames)

    monkeypatch.setattr(QuestionFrames, "show", frozen)


def _behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera hands over the frame before the newest."""
    show = QuestionFrames.show
    monkeypatch.setattr(
        QuestionFrames, "show", lambda self, indices: show(self, [i - 1 for i in indices if i])
    )


def _renamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera gives the frame before the newest the newest stamp."""
    show = QuestionFrames.show

    def renamed(self: QuestionFrames, indices: Any) -> Any:
        *_, old, new = show(self, indices)
        return (old, replace(new, jpeg=old.jpeg))

    monkeypatch.setattr(QuestionFrames, "show", renamed)


@pytest.mark.parametrize(
    ("break_camera", "why"),
    [
        (_frozen, "has the pixels of that of"),
        (_behind, "are not those of a question about"),
        (_renamed, "has the pixels of that of"),
    ],
)
def test_frames_that_are_not_of_now_are_our_fault(
    start: Start,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    break_camera: Callable[[pytest.MonkeyPatch], None],
    why: str,
) -> None:
    break_camera(monkeypatch)
    outcome, _, _ = drive(driven_run(start, python(folder, "keep")), start)
    assert outcome.kind == "harness"
    assert why in outcome.why


def test_the_world_waits_for_an_answer_at_the_step_of_its_frame(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It never passes a frame that hasn't been handed over."""
    drawn: list[int] = []

    class Watching(baselines.ConstantVelocity):
        frame_span_s, history_s, problem = 0.0, 1.7, ""

        def choose(self, stamps_ns: Any) -> list[int]:
            drawn.append(stamps_ns[-1])
            return [len(stamps_ns) - 1]

        def answer(self, question: Question) -> Answer:
            raise AssertionError("a model gives its answers")

        def give(self, question: Question) -> GivenAnswer:
            assert question.stamp_ns == drawn[-1] == question.frames[-1].stamp_ns
            return GivenAnswer(lane_plan(question), LatencyParts(300_000_000))

        def close(self) -> None:
            """Nothing is held."""

    monkeypatch.setitem(baselines.BASELINES, "watching", Watching)
    records = []
    for measured in (False, True):
        run = start.driven_by("watching", {}, Latency(0.3, measured))
        outcome, _, record = drive(run.model_copy(update={"camera": SMALL}), start)
        assert outcome.kind == "collision", outcome
        asked = [r.now_ns for r in record.reports if r.drive is not None and r.drive.question]
        assert drawn == asked
        drawn.clear()
        records.append([repr(r.truths) for r in record.reports])
    # A measured L counts as the same one that is fixed.
    assert records[0] == records[1]


# -- the command -----------------------------------------------------------------------------------


def test_a_start_leaves_no_time_for_a_longer_history_or_latency(
    start: Start, compiled_folder: Path, tmp_path: Path
) -> None:
    """The start was made for 1.7 s of motion and a latency of 0.5 s."""
    shutil.copytree(compiled_folder / TASK_FOLDER, tmp_path / TASK_FOLDER)
    run = start.driven_by("oracle", {}, Latency(0.5))
    entry = {"backend": "http", "options": {"url": "http://127.0.0.1:1"}}
    fits = {**entry, "history_s": start.first_request_s}
    longer = {**entry, "history_s": start.first_request_s + 0.1}

    def driven_by(given: dict[str, Any], latency_s: float) -> RunSpec:
        asked = Drive("mine", driver_options("mine", {"model": given}), Latency(latency_s))
        return single.driven_run(run, event_file, asked, lambda _: None)

    event_file = tmp_path / TASK_FOLDER / EVENT_FILE
    assert driven_by(fits, 0.5).driven is not None
    with pytest.raises(InputError, match=r"--drive mine: needs .* s of own motion.*name the event"):
        driven_by(longer, 0.5)
    with pytest.raises(InputError, match=r"--latency: is more than this start leaves time for"):
        driven_by(fits, 0.6)
    task = event_file.with_name(TASK_FILE)
    text = task.read_text()
    for spoilt, said in (
        (text[: len(text) // 2], "is not valid YAML or JSON"),
        (re.sub(r'"length_m": [0-9.]+', '"length_m": NaN', text, count=1), "length_m: .*number"),
        (text.replace("{", '{"sead": 1,', 1), r"sead: is not a known key .*did you mean seed"),
        (text.replace('"seed": 1', '"seed": 2', 1), "version: was changed after it was compiled"),
    ):
        assert spoilt != text
        task.write_text(spoilt)
        with pytest.raises(InputError, match=rf"task\.json.*{said}"):
            driven_by(fits, 0.5)


@pytest.fixture
def small_camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The command's runs have a camera of few pixels."""
    from ssp_scenario_manager.cli import run as module

    def prepare(*args: Any, **kwargs: Any) -> RunSpec:
        run = prepare_run(*args, **kwargs)
        return run if run.driven else run.model_copy(update={"camera": SMALL})

    monkeypatch.setattr(module, "prepare_run", prepare)
    return iter(())


def invoked(*arguments: str) -> Result:
    """The command's end, with its exit status as ``return_value``."""
    return CliRunner().invoke(run_command, list(arguments), standalone_mode=False)


@pytest.mark.usefixtures("small_camera")
def test_a_measured_run_leaves_its_bag_and_is_driven_again_to_the_same_bytes(
    tmp_path: Path, folder: Path
) -> None:
    """The model isn't needed the second time: its answers and their L are kept."""
    # A run's id is its folder's name.
    first, again = tmp_path / "first" / "run", tmp_path / "again" / "run"
    shutil.copy(folder / "driving_models.py", tmp_path / "model_for_a_day.py")
    model = python(tmp_path, "keep", function="model_for_a_day:keep")
    drive = f"mine={json.dumps(model)}"
    options = ["--in-process", "--record", "--seed", str(SEED)]
    given = ["--drive", drive, "--latency", "measured:0.5"]
    done = invoked("cut_in", *options, *given, "--out", str(first))
    assert (done.exception, done.return_value) == (None, 0), done.output
    assert "L of " in done.output
    (tmp_path / "model_for_a_day.py").unlink()
    done = invoked(str(first), *options[:2], "--out", str(again))
    assert (done.exception, done.return_value) == (None, 0), done.output
    told = [json.loads((f / "result.json").read_text())["driven"] for f in (first, again)]
    assert told[0] == told[1]
    assert told[0]["frames"] is True
    with np.load(first / "states.npz") as one, np.load(again / "states.npz") as other:
        assert all(np.array_equal(one[name], other[name]) for name in one.files)
    with BagReader(first / "bag") as bag, BagReader(again / "bag") as same:
        messages = [[(m.topic, m.log_time_ns, m.data) for m in b.messages()] for b in (bag, same)]
        assert messages[0] == messages[1]
        requests = [bag.decode(m) for m in bag.messages(["/ssp/vla/mine/request"])]
        responses = [bag.decode(m) for m in bag.messages(["/ssp/vla/mine/response"])]
        latencies = [bag.decode(m) for m in bag.messages(["/ssp/vla/mine/latency"])]
        pictures = bag.messages([names.absolute(names.CAMERA_IMAGE)])
        recorded = {m.log_time_ns: bytes(bag.decode(m).data) for m in pictures}
    shown = requests[-1].frames[-1]
    at_ns = shown.header.stamp.sec * 10**9 + shown.header.stamp.nanosec
    digest = hashlib.sha256(recorded[at_ns]).hexdigest()
    assert shown.format == f"jpeg; sha256:{digest}"
    assert (responses[0].model_id, responses[0].text) == (
        "python(model_for_a_day:keep)",
        "I keep my speed.",
    )
    assert load_run(first / "run.yaml").camera == SMALL
    assert (first / "answers.json").read_bytes() == (again / "answers.json").read_bytes()
    assert told[0]["measured"]["answers"] == len(latencies) == len(requests)
    parts = {one.key: float(one.value) for one in latencies[0].status[0].values}
    assert parts.pop("latency_s") == pytest.approx(sum(parts.values()), abs=1e-9)
    assert set(parts) == {"encoding_s", "transport_and_inference_s", "parsing_s"}
    charged = {response.request_id: response.latency for response in responses}
    assert charged["1"] == pytest.approx(float(latencies[0].status[0].values[0].value), abs=1e-9)
    (first / "answers.json").unlink()
    third = tmp_path / "third" / "run"
    done = invoked(str(first), "--in-process", "--out", str(third))
    assert "answers.json: isn't there" in str(done.exception)


def test_a_question_that_is_not_the_recorded_one_is_our_fault(start: Start, folder: Path) -> None:
    options = driver_options("mine", python(folder, "keep"))
    run = start.driven_by("mine", options, Latency(0.5, measured=True))
    assert run.driven is not None
    kept = answers_of(run.driven, drive(run, start)[2])
    other = [*kept[:9], replace(kept[9], question="sha256:0"), *kept[10:]]
    said: list[Any] = []
    recording = Mock(sent=said.append)
    result, record = run_in_process(run, listener=recording, answers=other)
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    assert (outcome.kind, result.verdict.name) == ("harness", "INVALID_HARNESS")
    assert outcome.at_s == record.reports[-1].now_ns / 1e9
    # Its bag tells the end, too.
    changes = [fact for fact in said if isinstance(fact, outbox.StateChanged)]
    assert changes[-1].state is SessionPhase.ABORTING
    assert changes[-1].verdict.name == "INVALID_HARNESS"
    assert "isn't the one that was recorded" in outcome.why


def test_a_session_that_passed_a_limit_asks_its_model_nothing_more(
    start: Start, folder: Path
) -> None:
    """An abort ends the model, and the question of its step has no plan."""
    options = driver_options("mine", python(folder, "fast"))
    run = start.driven_by("mine", options, Latency(0.0))
    assert run.driven is not None
    whole, record = run_in_process(run)
    at_ns = whole.aborted_ns
    assert at_ns is not None
    asked = [r.drive.question for r in record.reports if r.drive is not None and r.drive.question]
    before = sum(question.stamp_ns <= at_ns for question in asked)
    assert before < len(asked)
    kept = answers_of(run.driven, record)[:before]
    result, record = run_in_process(run, answers=kept)
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    assert (outcome.kind, result.verdict.name) == ("fence", "FAILED_SAFETY")
    assert (result.aborted_ns, result.reasons) == (at_ns, whole.reasons)


def test_a_session_that_an_operator_aborted_asks_its_model_nothing_more(
    start: Start, folder: Path, tmp_path: Path
) -> None:
    """A model that hangs would be waited for in the event-free twin."""
    shutil.copy(folder / "driving_models.py", tmp_path / "model_for_an_hour.py")
    options = python(tmp_path, "keep", function="model_for_an_hour:keep")
    run = for_one_process(driven_run(start, options, latency_s=0.5), camera=True)
    abort = Fault(kind="operator_abort", at_s=start.hand_over_s + 0.5)
    aborted = run.model_copy(update={"faults": [abort]})
    (tmp_path / "run.yaml").write_text(aborted.model_dump_json(by_alias=True))
    _, record, _ = run_recorded(aborted, tmp_path / "run.yaml", tmp_path / "bag", print)
    assert run.driven is not None
    for one in answers_of(run.driven, record):
        append_answer(tmp_path / NODE_ANSWERS_FILE, one)
    (tmp_path / "model_for_an_hour.py").unlink()
    told, why = session_summary(None, None, aborted, tmp_path / "bag")
    assert (told["driven"]["outcome"], why) == ("fence", ""), told
    assert told["driven"]["needless"].startswith("the operator aborted")
    kept = json.loads((tmp_path / "answers.json").read_text())
    assert kept["event"]
    assert kept["free"] == []


def test_a_trajectory_is_what_the_adapter_reads(start: Start, folder: Path) -> None:
    _, _, record = drive(driven_run(start, python(folder, "keep"), latency_s=0.5), start)
    plan = answers(record)[0].trajectory
    assert isinstance(plan, Trajectory)
    assert plan.t_s == tuple(0.5 * k for k in range(11))
