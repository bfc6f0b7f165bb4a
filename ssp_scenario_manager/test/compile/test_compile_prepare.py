"""The way from a name or a compiled folder to a run, and the messages of `ssp run` before it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.compile.compiler import CompiledEvent
from ssp_scenario_manager.compile.targets import folder
from ssp_scenario_manager.compile.targets.folder import mode_of, prepare_run
from ssp_scenario_manager.compile.task import TASK_FOLDER, load_task
from ssp_scenario_manager.maps.site import LIBRARY


def prepare(
    what: str | Path, folder: Path, site: str | None = None, seed: int | None = None
) -> RunSpec:
    return prepare_run(str(what), site, folder, seed=seed, mode="lockstep")


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made") / "compiled"
    arguments = ["--target", "track", "--site", "north_track", "--seed", "5", "--out", str(out)]
    assert main(["compile", "cut_in", *arguments]) == 0
    return out


@pytest.fixture
def compiled(compiled_once: Path, tmp_path: Path) -> Path:
    """A compiled folder that a test may spoil."""
    return Path(shutil.copytree(compiled_once, tmp_path / "compiled"))


def test_an_event_is_compiled_into_the_runs_task_folder(tmp_path: Path) -> None:
    for site, target, domain in (
        ("boulevard", "sumo", "simulation"),
        ("south_loop", "track", "physical"),
    ):
        folder = tmp_path / site
        run = prepare("vru_crossing", folder, site)
        assert (run.run_id, run.seed, run.domain) == (site, 1, domain)
        task = load_task(folder / TASK_FOLDER)
        assert (task.target, task.version) == (target, run.task_version)
        assert {path.name for path in (folder / TASK_FOLDER).iterdir()} == {
            "task.json",
            "event.yaml",
            "site.yaml",
            "log.jsonl",
        }
        # A run adds its id, seed and mode to the task's; nothing else differs.
        own = {"run_id": task.run.run_id, "seed": task.run.seed, "mode": task.run.mode}
        assert run.model_copy(update=own) == task.run


def test_a_compiled_folder_is_taken_over_with_its_changes(compiled: Path, tmp_path: Path) -> None:
    file = compiled / "run.yaml"
    value = yaml.safe_load(file.read_text())
    value["limits"]["speed_mps"] = 13.5
    file.write_text(yaml.safe_dump(value))
    run = prepare(compiled, tmp_path / "run", site="boulevard")  # a launch file always names one
    assert (run.limits.speed_mps, run.seed, run.run_id) == (13.5, 5, "run")
    task = load_task(tmp_path / "run" / TASK_FOLDER)
    assert task.run.limits.speed_mps == 15.0
    for name in ("task.json", "event.yaml", "site.yaml", "log.jsonl"):
        copy = tmp_path / "run" / TASK_FOLDER / name
        assert copy.read_bytes() == (compiled / name).read_bytes()
    assert not (tmp_path / "run" / TASK_FOLDER / "run.yaml").exists()
    assert prepare(compiled, tmp_path / "again", seed=8).seed == 8


def test_a_compiled_map_is_taken_over(
    tmp_path: Path, event_on_road: Callable[[str, int, int], str]
) -> None:
    out = tmp_path / "compiled"
    motorway = LIBRARY / "maps" / "motorway.xodr"
    arguments = ["--target", "sumo", "--map", str(motorway), "--out", str(out)]
    assert main(["compile", event_on_road("cut_in", 3, 0), *arguments]) == 0
    run = prepare(out, tmp_path / "run")
    assert run.site == "motorway.xodr"
    assert (tmp_path / "run" / TASK_FOLDER / "motorway.xodr").is_file()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("event.yaml", "is not what the task was compiled from"),
        ("site.yaml", "is not what the task was compiled from"),
    ],
)
def test_an_exchanged_event_or_site_is_refused(
    name: str, text: str, compiled: Path, tmp_path: Path
) -> None:
    value = yaml.safe_load((compiled / name).read_text())
    value["description"] = "another"
    (compiled / name).write_text(yaml.safe_dump(value))
    with pytest.raises(InputError, match=text) as caught:
        prepare(compiled, tmp_path / "run")
    assert caught.value.file == str(compiled / name)
    assert not (tmp_path / "run").exists()


def test_a_run_of_another_task_is_refused(compiled: Path, tmp_path: Path) -> None:
    value = yaml.safe_load((compiled / "run.yaml").read_text())
    value["task_version"] = "sha256:another"
    (compiled / "run.yaml").write_text(yaml.safe_dump(value))
    with pytest.raises(InputError, match="is not what the task was compiled from") as caught:
        prepare(compiled, tmp_path / "run")
    assert caught.value.field == "task_version"


def test_a_task_of_an_earlier_version_keeps_its_seal(compiled: Path) -> None:
    """It was sealed without the fields that came later."""
    value = json.loads((compiled / "task.json").read_text())
    del value["run"]["passing"], value["version"], value["run"]["task_version"]
    version = sha256_json(value)
    value["version"] = value["run"]["task_version"] = version
    (compiled / "task.json").write_text(json.dumps(value))
    assert load_task(compiled).version == version
    value["run"]["seed"] += 1
    (compiled / "task.json").write_text(json.dumps(value))
    with pytest.raises(InputError, match="was changed after it was compiled"):
        load_task(compiled)


def test_a_missing_file_is_named(compiled: Path, tmp_path: Path) -> None:
    (compiled / "event.yaml").unlink()
    with pytest.raises(InputError, match=r"event\.yaml"):
        prepare(compiled, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_what_is_neither_event_nor_compiled_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no compiled folder and no session's"):
        prepare(tmp_path, tmp_path / "run", "boulevard")
    with pytest.raises(InputError, match="needs a site"):
        prepare("cut_in", tmp_path / "run")
    with pytest.raises(InputError, match="no such event"):
        prepare("overtake", tmp_path / "run", "boulevard")
    assert not (tmp_path / "run").exists()


def test_what_another_compilation_wrote_meanwhile_is_kept(
    compiled: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each of two that begin at once finds no folder."""
    out = tmp_path / "out"
    write_target = folder.write_target

    def written_late(made: CompiledEvent, work: Path) -> None:
        write_target(made, work)
        shutil.copytree(compiled, out)

    monkeypatch.setattr(folder, "write_target", written_late)
    where = ["--target", "track", "--site", "north_track", "--seed", "6", "--out", str(out)]
    assert main(["compile", "cut_in", *where]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert load_task(out).run.seed == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["compiled", "out"]


def test_run_refuses_a_site_beside_a_compiled_folder(
    compiled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["run", str(compiled), "--site", "boulevard", "--out", str(out)]) == 1
    assert "--site" in capsys.readouterr().err
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    assert main(["run", str(compiled), "--out", str(tmp_path / "mine")]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert not out.exists()


def test_a_sessions_folder_is_run_again_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    faults = tmp_path / "faults.yaml"
    fault = {"kind": "link_cut", "target": "ot1", "at_s": 3.0}
    faults.write_text(yaml.safe_dump({"schema": "ssp.faults/1", "faults": [fault]}))
    given = ["--in-process", "--seed", "7", "--faults", str(faults), "--out", str(first)]
    assert main(["run", "cut_in", *given]) == 1
    assert main(["run", str(first), "--in-process", "--out", str(again)]) == 1

    def fields_of(folder: Path, name: str, *but: str) -> dict[str, object]:
        value = json.loads((folder / name).read_text())
        return {key: value[key] for key in value if key not in but}

    assert fields_of(again, "result.json", "run_id") == fields_of(first, "result.json", "run_id")
    assert fields_of(again, "run.yaml", "run_id") == fields_of(first, "run.yaml", "run_id")
    assert fields_of(first, "result.json")["seed"] == 7
    assert (again / TASK_FOLDER / "task.json").read_bytes() == (
        first / TASK_FOLDER / "task.json"
    ).read_bytes()
    capsys.readouterr()
    assert main(["run", str(first), "--in-process", "--out", str(first)]) == 1
    assert "is not empty" in capsys.readouterr().err


def test_the_mode_of_a_sessions_folder_is_its_own(compiled: Path, tmp_path: Path) -> None:
    session = tmp_path / "session"
    run = prepare(compiled, session)
    assert mode_of(str(session)) == "lockstep"  # nothing was run there yet
    executed = run.model_copy(update={"mode": "realtime"})
    (session / "run.yaml").write_text(executed.model_dump_json(by_alias=True))
    assert mode_of(str(session)) == "realtime"
    other = executed.model_copy(update={"task_version": "sha256:other"})
    (session / "run.yaml").write_text(other.model_dump_json(by_alias=True))
    with pytest.raises(InputError, match="is not what the task was compiled from") as caught:
        prepare(session, tmp_path / "again")
    assert caught.value.file == str(session / "run.yaml")


def test_a_run_off_its_specification_exits_with_1_and_is_a_failure_for_build_servers(
    compiled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    value = yaml.safe_load((compiled / "run.yaml").read_text())
    value["passing"]["most_gap_s"] = 0.5
    (compiled / "run.yaml").write_text(yaml.safe_dump(value))
    out, junit = tmp_path / "run", tmp_path / "junit.xml"
    given = ["--in-process", "--junit", str(junit), "--json", "--out", str(out)]
    assert main(["run", str(compiled), *given]) == 1
    told = json.loads(capsys.readouterr().out)
    (reason,) = told["reasons"]
    assert (told["verdict"], told["wanted"]["most_gap_s"]) == ("off_spec", 0.5)
    assert reason == (
        f"time gap at the conflict point: {told['time_gap_s']:.3f} s, K* wants 0.2 to 0.5 s"
    )
    (run,) = ElementTree.parse(junit).iter("testcase")
    assert [(part.tag, part.get("type")) for part in run if part.tag != "properties"] == [
        ("failure", "off_spec")
    ]
