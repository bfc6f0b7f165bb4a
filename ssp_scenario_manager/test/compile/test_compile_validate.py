"""``--validated-by``: what a run's recording must say before a track task takes its values over."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ssp_core.bag.types import serialize, typestore
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.vocabulary import Phase, SessionPhase, Verdict
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.compile.validate import read_validation

FILES = ("task.json", "run.yaml", "event.yaml", "site.yaml", "log.jsonl")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sim") / "task"
    arguments = ["--target", "sumo", "--site", "boulevard", "--out", str(folder)]
    assert main(["compile", "cut_in", *arguments]) == 0
    return folder


def record(
    folder: Path,
    task: Path,
    verdict: Verdict = Verdict.VALID,
    told: dict[str, Any] | None = None,
    safety: bool = False,
) -> Path:
    """The folder of a run with the messages that speak of its end, and the runner's word."""
    types = typestore().types
    bag = folder / "bag"
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=1, nanosec=0), frame_id="map"
    )
    messages: list[tuple[str, Any]] = [
        (
            "/ssp/phase_event",
            types["ssp_msgs/msg/PhaseEvent"](
                header=header, phase=int(phase), evidence="seen", provisional=phase.is_provisional
            ),
        )
        for phase in Phase
        if phase is not Phase.UNKNOWN
    ]
    if safety:
        event = types["ssp_msgs/msg/SafetyEvent"](
            header=header,
            code=20,
            limit_name="separation",
            source="manager",
            object_id="ot1",
            measured=0.1,
            limit=0.5,
            unit="m",
            reaction="abort",
            words="",
        )
        messages.append(("/ssp/safety_event", event))
    ends = ((SessionPhase.RUNNING, Verdict.NONE), (SessionPhase.FINISHED, verdict))
    for state, word in ends:
        message = types["ssp_msgs/msg/SessionState"](
            header=header,
            state=int(state),
            previous=0,
            event="test",
            reason="",
            run_id="r1",
            scenario="cut_in",
            event_version="",
            verdict=int(word),
            reasons=[],
        )
        messages.append(("/ssp/session_state", message))
    with BagWriter(bag) as writer:
        for name in FILES:
            writer.attach(name, (task / name).read_bytes(), "text/plain")
        for topic, msgtype in {topic: m.__msgtype__ for topic, m in messages}.items():
            writer.add_topic(topic, msgtype)
        for number, (topic, message) in enumerate(messages, start=1):
            writer.write(topic, serialize(message), number * 1_000_000, number * 1_000_000)
    said = told or {"verdict": "valid", "reasons": []}
    (folder / "result.json").write_text(json.dumps({"schema": "ssp.result/1", **said}))
    (bag / "verdict.json").write_text(json.dumps({"schema": "ssp.verdict/1", **said}))
    return folder


def event_version(task: Path) -> str:
    return load_task(task).event.version


def test_a_valid_run_validates(compiled: Path, tmp_path: Path) -> None:
    found = read_validation(record(tmp_path, compiled), event_version(compiled))
    assert found.validation.task_version == load_task(compiled).version
    assert found.values["constraints.trigger.below"] == 18.0


@pytest.mark.parametrize("place", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_a_flipped_byte_anywhere_in_the_bag_is_found(
    place: float, compiled: Path, tmp_path: Path
) -> None:
    (file,) = (record(tmp_path, compiled) / "bag").glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[int(place * len(data))] ^= 1
    file.write_bytes(data)
    with pytest.raises(InputError, match="is no sound recording"):
        read_validation(tmp_path, event_version(compiled))


@pytest.mark.parametrize("verdict", [v for v in Verdict if v is not Verdict.VALID])
def test_the_verdict_is_the_recorded_one(verdict: Verdict, compiled: Path, tmp_path: Path) -> None:
    record(tmp_path, compiled, verdict)
    with pytest.raises(InputError, match="by the last session state in it") as caught:
        read_validation(tmp_path, event_version(compiled))
    assert caught.value.value == verdict.name.lower()


def test_a_recorded_safety_event_validates_nothing(compiled: Path, tmp_path: Path) -> None:
    record(tmp_path, compiled, safety=True)
    with pytest.raises(InputError, match=r"records 1 safety event.*separation"):
        read_validation(tmp_path, event_version(compiled))


def test_no_word_changed_in_one_file_makes_a_run_valid(compiled: Path, tmp_path: Path) -> None:
    failed = {"verdict": "invalid_harness", "reasons": ["the recorder was killed"]}
    record(tmp_path, compiled, told=failed)
    files = (tmp_path / "result.json", tmp_path / "bag" / "verdict.json")
    for file in files:
        before = file.read_text()
        file.write_text(before.replace("invalid_harness", "valid"))
        with pytest.raises(InputError, match="can't validate anything"):
            read_validation(tmp_path, event_version(compiled))
        file.write_text(before)
    for file in files:
        file.write_text(file.read_text().replace("invalid_harness", "valid"))
    with pytest.raises(InputError, match="can't validate anything") as caught:
        read_validation(tmp_path, event_version(compiled))
    assert caught.value.field == "reasons"


def test_a_run_without_the_runners_word_validates_nothing(compiled: Path, tmp_path: Path) -> None:
    (record(tmp_path, compiled) / "bag" / "verdict.json").unlink()
    with pytest.raises(InputError, match=r"verdict\.json"):
        read_validation(tmp_path, event_version(compiled))
