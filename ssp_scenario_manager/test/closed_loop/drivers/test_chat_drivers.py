"""A model behind a chat service drives, and its recorded answers drive the same run again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.latency import Latency
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import driver_options
from ssp_scenario_manager.closed_loop.outcomes.outcome import Outcome, outcome_of
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import Record, run_recorded
from ssp_scenario_manager.run.sweep import for_one_process
from tests.support.models.chat_service import chat_service
from tests.support.models.egodrivers import SMALL

SEED = 1
STAGES = ("A car in the left lane.", "The car cuts in.", "I brake for it.")


def motion(number: int) -> str:
    """Ten speeds and curvatures, 0.5 s apart, in an answer; it brakes from the 7th answer on."""
    speeds = [max(0.0, 13.0 - 2.0 * max(0, number + k - 6)) for k in range(10)]
    # OpenEMMA's interface has metres per step.
    return ", ".join(f"[{v / 2.0:.2f}, 0.0]" for v in speeds)


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    folder = tmp_path_factory.mktemp("chat") / "cut_in"
    compiled = prepare_run("cut_in", "boulevard", folder, seed=SEED, mode="lockstep")
    small = compiled.model_copy(update={"camera": SMALL})
    return make_start(small, load_event("cut_in")[0], SEED, latency_max_s=0.5)


def driven_by(options: dict[str, Any], start: Start, folder: Path) -> tuple[Outcome, Record]:
    """Drive one run by a model, and leave its bag."""
    run = start.driven_by("mine", driver_options("mine", options), Latency(0.5))
    run = for_one_process(run, camera=True)
    folder.mkdir()
    (folder / "run.yaml").write_text(run.model_dump_json(by_alias=True))
    result, record, _ = run_recorded(run, folder / "run.yaml", folder / "bag", print)
    assert run.driven is not None
    assert result.verdict is Verdict.VALID
    return outcome_of(run, run.driven, result, record, start.twin), record


def driver_answers(record: Record) -> list[tuple[str, Trajectory | None, str]]:
    drives = [report.drive for report in record.reports if report.drive is not None]
    given = [one.effective_answer.answer for one in drives if one.effective_answer is not None]
    return [(one.text, one.trajectory, one.refused) for one in given]


def test_a_chat_service_drives_and_so_do_its_recorded_answers(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    with chat_service() as service:
        service.answers = [text for n in range(50) for text in (*STAGES, motion(n))]
        chat = {"backend": "openai", "base_url": service.url, "model": "seer-7b"}
        outcome, record = driven_by(chat, start, tmp_path / "chat")
        asked = list(service.asked)
    answers = driver_answers(record)
    assert outcome.kind == "avoided"
    # The four stages of each question, each with the newest picture.
    questions = [report for report in record.reports if report.drive and report.drive.question]
    assert [len(one.pictures) for one in asked] == [1] * 4 * len(questions)
    assert answers[0][0] == "\n\n".join((*STAGES, motion(0)))
    assert answers[0][1] is not None
    assert answers[0][1].x_m[:3] == (0.0, 6.5, 13.0)
    stored = {"backend": "recorded", "file": str(tmp_path / "chat" / "bag")}
    again, same = driven_by({**stored, "interface": "openemma"}, start, tmp_path / "recorded")
    assert driver_answers(same) == answers
    assert (again, same.sha256) == (outcome, record.sha256)
