"""Campaigns over several processes: the same cells, and no cell is ever left out."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from ssp_core.errors import HostError, InputError
from ssp_core.files.folders import TAKEN_FILE, taken_folder
from ssp_core.host.ray_cluster import import_ray
from ssp_eval.data.labels import labels_version, load_labels
from ssp_eval.data.provenance import find_labels
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cli import evaluate
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import ModelSpec, attached_spec, bridge_spec
from ssp_eval.evaluate.conditions.expansion import with_controls
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.executors import Job, JobRunner, Settings
from ssp_eval.evaluate.run import run_parallel
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.recordings.clip import Clip
from ssp_eval.report.page import write_report
from tests.support.processes.waiting import DEADLINE_S, until

BagMaker = Callable[..., Path]
MODELS = ("constant_velocity", "perfect")


@pytest.fixture(autouse=True)
def doubles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets workers import what stands in for models here."""
    let_import_doubles(monkeypatch)


def let_import_doubles(patch: pytest.MonkeyPatch) -> None:
    folder = str(Path(__file__).parents[2])
    patch.syspath_prepend(folder)
    patch.setenv(
        "PYTHONPATH", os.pathsep.join(filter(None, (folder, os.environ.get("PYTHONPATH"))))
    )


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A cluster of Ray with room for two workers; to start one takes long."""
    ray = import_ray()
    with pytest.MonkeyPatch.context() as patch:
        let_import_doubles(patch)
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield
    ray.shutdown()


@pytest.fixture(params=["processes", pytest.param("ray", marks=pytest.mark.programs)])
def engine(request: pytest.FixtureRequest) -> str:
    """The name of an engine that runs the workers; for Ray, its cluster is up."""
    if request.param == "ray":
        request.getfixturevalue("cluster")
    return str(request.param)


def double(name: str) -> Any:
    return getattr(importlib.import_module("campaign_doubles"), name)


@pytest.fixture
def bags(make_bag: BagMaker) -> list[tuple[Path, Path | None]]:
    return [(make_bag(), None), (make_bag("track", domain="physical"), None)]


def settings(out: Path, direct: Any = InProcessClients) -> Settings:
    return Settings(out=out, make_extractor=Extractor, direct=direct)


def content(out: Path) -> dict[str, Any]:
    """All files of the cells, without ids, latencies and the hashes of what holds these."""
    found: dict[str, Any] = {}
    for file in sorted((out / "cells").rglob("*")):
        name = str(file.relative_to(out))
        if file.name in ("raw.jsonl", "requests.jsonl"):
            found[name] = [_bare(json.loads(line)) for line in file.read_text().splitlines()]
        elif file.name == "cell.json":
            facts = json.loads(file.read_text())
            for key in ("raw", "requests", "cell"):
                del facts["hashes"][key]
            found[name] = facts
        elif file.is_file():
            found[name] = file.read_bytes()
    found["frames"] = sorted(file.name for file in (out / "frames").iterdir())
    return found


def _bare(value: dict[str, Any]) -> dict[str, Any]:
    previous = value.get("previous")
    if isinstance(previous, dict):
        value["previous"] = {k: v for k, v in previous.items() if k != "request_id"}
    return {k: v for k, v in value.items() if k not in ("request_id", "latency_s")}


def test_workers_give_what_one_process_gives(
    bags: list[tuple[Path, Path | None]], tmp_path: Path, engine: str
) -> None:
    models = with_controls([bridge_spec(name) for name in (*MODELS, "opencv_baseline")])
    one, many = tmp_path / "one", tmp_path / "many"
    first = run_campaign(bags, models, InProcessClients(), one, CellOptions(), True)
    told, records = [], []
    second = run_parallel(
        bags,
        models,
        settings(many),
        2,
        engine,
        on_plan=told.append,
        on_record=lambda: records.append(1),
    )
    alone, together = content(one), content(many)
    assert alone.keys() == together.keys()
    for name, value in alone.items():
        assert value == together[name], name
    assert [r.folder.name for r in first] == [r.folder.name for r in second]
    assert [r.score for r in first] == [r.score for r in second]
    assert [plan.label_times for plan in told] == [len(records)]
    again = run_parallel(bags, models, settings(many), 1, engine)
    assert sum(result.sent for result in again) == 0


def test_a_worker_that_dies_is_a_failed_cell(
    bags: list[tuple[Path, Path | None]], tmp_path: Path, engine: str
) -> None:
    models = [ModelSpec("deadly", backend="constant_velocity"), bridge_spec("constant_velocity")]
    results = run_parallel(bags, models, settings(tmp_path, double("Deadly")), 2, engine, True)
    status = [(result.model, result.status) for result in results]
    assert status == [("deadly", "failed"), ("constant_velocity", "ok")] * 2
    for result in results[::2]:
        assert result.reasons[0].startswith("the worker died: ")
        if engine == "processes":
            assert result.reasons == ("the worker died: killed by SIGKILL",)
        assert json.loads((result.folder / "cell.json").read_text())["status"] == "failed"
        assert not (result.folder / "score.json").exists()
    page = write_report(tmp_path).read_text()
    assert "the worker died" in page
    assert "<dt>failed</dt><dd>2</dd>" in page


def test_a_wrong_option_ends_the_campaign_as_in_one_process(
    bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    models = [bridge_spec("constant_velocity")]
    with pytest.raises(InputError, match=r"speed: is wrong \(got 3\)") as caught:
        run_parallel(bags, models, settings(tmp_path, double("Wrong")), 1, propose_labels=True)
    assert caught.value.field == "speed"


def test_a_worker_of_another_version_is_refused(
    bags: list[tuple[Path, Path | None]], tmp_path: Path, engine: str
) -> None:
    changed = replace(settings(tmp_path), make_extractor=double("another_each_time"))
    with pytest.raises(HostError, match="install the same version everywhere"):
        run_parallel(bags, [bridge_spec("constant_velocity")], changed, 1, engine, True)
    assert not list(tmp_path.rglob("score.json"))


def test_a_bug_in_a_worker_shows_its_traceback(
    bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    models = [bridge_spec("constant_velocity")]
    with pytest.raises(RuntimeError, match="ZeroDivisionError: on purpose"):
        run_parallel(bags, models, settings(tmp_path, double("Faulty")), 1, propose_labels=True)


def test_attached_bridges_have_one_worker(
    bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="can't be asked by several workers"):
        run_parallel(bags, [attached_spec("mine")], settings(tmp_path), 2)


def test_without_ray_the_remedy_is_named(
    bags: list[tuple[Path, Path | None]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(HostError, match=r"pip install 'ssp\[ray\]'"):
        run_parallel(bags, [bridge_spec("silent")], settings(tmp_path), 2, "ray")
    assert not (tmp_path / "cells").exists()
    with pytest.raises(HostError):
        import_ray()


@pytest.mark.ros
@pytest.mark.system
def test_each_worker_has_bridges_of_its_own(
    bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = CliRunner().invoke(
        evaluate,
        [
            *(str(bag) for bag, _ in bags),
            "--bridge",
            "constant_velocity",
            "--propose-labels",
            "--out",
            str(out),
            "--workers",
            "2",
            "--json",
            "--no-controls",
        ],
    )
    assert run.exit_code == 0, run.output
    cells = [json.loads(line) for line in run.output.splitlines() if line.startswith("{")]
    assert [cell["status"] for cell in cells] == ["ok", "ok"]
    logs = {file.parent.name for file in (out / "logs").rglob("*constant_velocity*")}
    assert logs == {"worker_0", "worker_1"}


@pytest.mark.programs
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_the_terminal_ends_every_worker_in_order(
    number: signal.Signals, bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    out, script = tmp_path / "out", tmp_path / "campaign.py"
    script.write_text(SLOW)
    process = subprocess.Popen(
        [sys.executable, str(script), str(out), *(str(bag) for bag, _ in bags)],
        start_new_session=True,
        stderr=subprocess.PIPE,
    )
    group = process.pid
    try:

        def both_ask() -> bool:
            assert process.poll() is None, process.communicate()[1].decode()
            return len(list(tmp_path.glob("out/asked_*"))) >= 2

        until(both_ask, "question of both workers")
        os.killpg(group, number)
        _, error = process.communicate(timeout=DEADLINE_S)
    finally:
        if process.poll() is None:
            os.killpg(group, signal.SIGKILL)
            process.wait()
    assert process.returncode != 0
    assert error.decode().count("KeyboardInterrupt") == 1, error.decode()
    until(lambda: not _there(group), "end of all workers")


def _there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


SLOW = """
import signal, sys, time
from pathlib import Path
from ssp_eval.evaluate.clients.model_client import (InProcessClients)
from ssp_eval.evaluate.executors import Settings
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.run import run_parallel
from ssp_core.host.ray_cluster import ADDRESS, import_ray, joined, look_for

from ssp_eval.extract.combined.extractor import Extractor

out = Path(sys.argv[1])

class Slow(InProcessClients):
    def client(self, model, options):
        import os
        (out / f"asked_{os.getpid()}").touch()
        time.sleep(600.0)

if __name__ == "__main__":
    # As the command line does; who is started in the background inherits what is to be ignored.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    bags = [(Path(bag), None) for bag in sys.argv[2:]]
    settings = Settings(out=out, make_extractor=Extractor, direct=Slow)
    run_parallel(bags, [bridge_spec("constant_velocity")], settings, 2, propose_labels=True)
"""


@pytest.mark.parametrize("changed", ["bag_sha256", "labels_sha256"])
def test_a_worker_takes_only_the_files_that_the_campaign_began_with(
    changed: str, bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    model, bag = bridge_spec("constant_velocity"), bags[0][0]
    run_campaign(bags[:1], [model], InProcessClients(), tmp_path / "one", CellOptions(), True)
    labels = find_labels(bag)
    assert labels is not None
    with Clip(bag) as clip:
        bag_sha256 = clip.provenance.bag_sha256
    job = Job(0, bag, labels, (model,), bag_sha256, labels_version(load_labels(labels)))
    out = tmp_path / "many"
    with JobRunner(settings(out), "worker_0") as runner:
        assert [result.status for result in runner.run(job)] == ["ok"]
        with pytest.raises(InputError, match="isn't what the campaign began with"):
            runner.run(replace(job, **{changed: "sha256:other"}))


@pytest.mark.programs
@pytest.mark.usefixtures("cluster")
def test_a_cluster_with_room_for_fewer_workers_does_all_cells(
    bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    models = [bridge_spec(name) for name in MODELS]
    results = run_parallel(bags, models, settings(tmp_path), 4, "ray", True)
    assert [result.status for result in results] == ["ok"] * 4


def test_a_folder_has_one_command_at_a_time(
    bags: list[tuple[Path, Path | None]], tmp_path: Path
) -> None:
    out, models = tmp_path / "out", [bridge_spec("constant_velocity")]
    with taken_folder(out):
        with pytest.raises(InputError, match="another command is writing into"):
            run_campaign(bags, models, InProcessClients(), out, CellOptions(), True)
        with pytest.raises(InputError, match="another command is writing into"):
            run_parallel(bags, models, settings(out), 2, propose_labels=True)
        assert [entry.name for entry in out.iterdir()] == [TAKEN_FILE]
    assert run_campaign(bags[:1], models, InProcessClients(), out, CellOptions())[0].status == "ok"
