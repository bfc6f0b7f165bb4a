"""The topic path: real bridges in processes of their own, in a domain of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import pytest

from ssp_core.errors import InputError
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.processes import ProcessGroup
from ssp_eval.evaluate.bridges import BRIDGE_MODULE, PROFILE, TopicClients, _in_time
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cli import evaluate as evaluate_command
from ssp_eval.evaluate.cli import model_specs
from ssp_eval.evaluate.clients.model_client import ModelClient
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers, ModelReply
from ssp_eval.evaluate.clients.models import PICTURES, ModelSpec, bridge_spec
from ssp_eval.evaluate.clients.topic_client import Timeouts, TopicClient
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.labels.propose import propose
from ssp_eval.labels.review import write_proposal
from ssp_eval.labels.truth import truth_from_bag
from ssp_vla_bridge.messages import Request

BagMaker = Callable[..., Path]


class Killing:
    """Kills the bridge before one of the requests is sent."""

    def __init__(self, inner: TopicClients, at: int) -> None:
        self.inner, self.at, self.count = inner, at, 0
        self.pids: list[int] = []

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        client = self.inner.client(model, options)
        if not isinstance(client, TopicClient):
            raise TypeError(client)
        return _KillingClient(self, client)


class _KillingClient:
    def __init__(self, owner: Killing, inner: TopicClient) -> None:
        self.owner, self.inner = owner, inner

    @property
    def ignored(self) -> IgnoredAnswers:
        return self.inner.ignored

    def ask(self, request: Request) -> ModelReply:
        process = self.inner.process
        if process is None:
            raise ValueError("the bridge was not started here")
        self.owner.pids.append(process.process.pid)
        if self.owner.count == self.owner.at:
            # A stopped process takes the request and never answers; then it is killed for good.
            os.kill(process.process.pid, signal.SIGSTOP)
            os.kill(process.process.pid, signal.SIGKILL)
        self.owner.count += 1
        return self.inner.ask(request)


@pytest.mark.ros
def test_a_campaign_over_topics_and_a_killed_bridge(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    before = dict(os.environ)
    with TopicClients(out / "logs", 20.0, attached=False) as clients:
        killing = Killing(clients, at=3)
        (result,) = run_campaign(
            [(bag, None)], [bridge_spec("constant_velocity")], killing, out, CellOptions(), True
        )
    assert dict(os.environ) == before
    assert result.status == "ok"
    # The bridge was started again; the record that died with it is the only loss, and where it
    # was noticed before the request went out, there is none at all.
    assert result.missing <= 1
    assert len(set(killing.pids)) == 2
    for entry in json.loads((result.folder / "cell.json").read_text())["answers"]["missing"]:
        assert "killed by SIGKILL" in entry["reason"]
    for pid in set(killing.pids):
        assert not Path(f"/proc/{pid}").exists()


@pytest.mark.ros
def test_the_command_line_reaches_1_with_the_perfect_bridge(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        str(make_bag()),
        "--propose-labels",
        "--bridge",
        "perfect",
        "--out",
        str(tmp_path / "out"),
        "--json",
    ]
    # Not through click's runner: the executor wants a standard error with a file descriptor.
    assert evaluate_command.main(arguments, standalone_mode=False) == 0
    printed = capfd.readouterr()
    lines = {line["model"]: line for line in map(json.loads, printed.out.splitlines())}
    assert lines["perfect"]["score"]["ivcs"] == pytest.approx(1.0)
    assert {name: line["control"] for name, line in lines.items()} == {
        "perfect": False,
        "constant_velocity": True,
        "copy_history": True,
        "silent": True,
    }
    assert [line["sent"] for line in lines.values()] == [9] * 4
    told = " ".join(printed.err.split())
    assert "labels in approach/trigger/conflict/resolution, cut_in: simulation 4/0/5/0" in told
    assert (
        "4 cells, 36 questions; of these 27 for controls: 27 go to the built-in answerers "
        "(--no-controls leaves them out)" in told
    )


@pytest.mark.ros
def test_a_bridge_that_can_t_start_fails_its_cell_only(make_bag: BagMaker, tmp_path: Path) -> None:
    with TopicClients(tmp_path / "logs", 20.0, attached=False) as clients:
        results = run_campaign(
            [(make_bag(), None)],
            [ModelSpec("nonsense"), ModelSpec("silent")],
            clients,
            tmp_path / "out",
            CellOptions(),
            True,
        )
    assert [result.status for result in results] == ["failed", "ok"]
    assert "no such backend" in results[0].reasons[0]


@pytest.mark.ros
def test_an_attached_bridge_outlives_its_evaluations(make_bag: BagMaker, tmp_path: Path) -> None:
    bag = make_bag()
    with free_domain() as domain_id:
        environment = session_environment(domain_id, PROFILE)
        command = [sys.executable, "-m", "ssp_core.cli", "evaluate", str(bag), "--propose-labels"]
        with ProcessGroup(environment, tmp_path / "logs") as group:
            parameters: dict[str, object] = {"model": "mine", "backend": "constant_velocity"}
            bridge = group.start_node("mine", BRIDGE_MODULE, parameters)
            for attempt in range(2):
                out = tmp_path / f"out{attempt}"
                run = subprocess.run(
                    [*command, "--attach", "mine", "--out", str(out), "--json"],
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=600,
                    check=False,
                )
                assert run.returncode == 0, run.stderr
                lines = [json.loads(line) for line in run.stdout.splitlines()]
                # The answerers are in the command's own process, in nobody's ROS domain.
                assert [line["model"] for line in lines] == [
                    "mine",
                    "mine+black",
                    "mine+shuffled",
                    "constant_velocity",
                    "copy_history",
                    "perfect",
                    "silent",
                ]
                assert {line["missing"] for line in lines} == {0}
                assert bridge.returncode is None
                assert not (out / "logs").exists()


def test_started_and_attached_bridges_don_t_mix() -> None:
    with pytest.raises(click.UsageError, match="run twice"):
        model_specs(["silent"], ["mine"])
    with pytest.raises(click.UsageError, match="stands 2 times"):
        model_specs(["silent", "silent={}"], [])
    with pytest.raises(click.UsageError, match="name a model"):
        model_specs([], [])
    with pytest.raises(InputError, match="no name for a topic"):
        model_specs(["a b"], [])


@pytest.mark.ros
def test_the_evaluator_s_node_takes_a_models_file(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    write_proposal(
        tmp_path / "bag.labels.json", propose(truth_from_bag(bag)), source="sha256:" + "0" * 64
    )
    models = tmp_path / "models.yaml"
    models.write_text(
        "schema: ssp.models/1\n"
        "models:\n"
        "  mine: {backend: constant_velocity, frames: 2, total_b: 1.5}\n"
    )
    with free_domain() as domain_id:
        environment = session_environment(domain_id, PROFILE)
        with ProcessGroup(environment, tmp_path / "logs") as group:
            group.start_node(
                "mine", BRIDGE_MODULE, {"model": "mine", "backend": "constant_velocity"}
            )
            run = subprocess.run(
                [
                    sys.executable,
                    "-m",
                    "ssp_eval.ros.evaluator_node",
                    "--ros-args",
                    "-p",
                    f"bags:=[{bag}]",
                    "-p",
                    f"models_file:={models}",
                    "-p",
                    f"out:={out}",
                    "-p",
                    "pictures:=true",
                ],
                env=environment,
                capture_output=True,
                text=True,
                timeout=600,
                check=False,
            )
    assert run.returncode == 0, run.stderr
    told = [line.removeprefix("cut_in__simulation__") for line in run.stdout.splitlines()]
    assert told == [
        "mine: ok",
        "mine+black: ok",
        "mine+shuffled: ok",
        *(f"mine+{name}: ok" for name in PICTURES),
        "mine+repeat: ok",
        "constant_velocity: ok",
        "copy_history: ok",
        "perfect: ok",
        "silent: ok",
    ]
    assert "of these 54 for controls" in run.stderr
    assert "(-p controls:=false leaves them out)" in run.stderr
    cell = json.loads((out / "cells" / "cut_in__simulation__mine" / "cell.json").read_text())
    assert (cell["preprocessing"]["frames"], cell["model_facts"]["total_b"]) == (2, 1.5)
    assert cell["answers"]["missing"] == []


_STUCK = """
import time
from pathlib import Path

def once(request, options):
    mark = Path(options["mark"])
    before = len(mark.read_text()) if mark.exists() else 0
    mark.write_text("." * (before + 1))
    if before == 2:
        time.sleep(1000.0)
    return "I keep my speed."

def always(request):
    time.sleep(1000.0)
"""


@pytest.mark.ros
def test_a_request_that_hangs_costs_its_own_answer_only(make_bag: BagMaker, tmp_path: Path) -> None:
    (tmp_path / "stuck.py").write_text(_STUCK)
    common = {"backend": "python", "folder": str(tmp_path), "timeout_s": 2.0}
    once = {**common, "function": "stuck:once", "options": {"mark": str(tmp_path / "mark")}}
    models = [
        bridge_spec(f"once={json.dumps(once)}"),
        bridge_spec(f"always={json.dumps({**common, 'function': 'stuck:always'})}"),
    ]
    with TopicClients(tmp_path / "logs", 20.0, attached=False) as clients:
        results = run_campaign(
            [(make_bag(), None)], models, clients, tmp_path / "out", CellOptions(), True
        )
    assert [(result.status, result.missing) for result in results] == [("ok", 1), ("failed", 9)]
    assert dict(results[0].losses) == {"no answer in time": 1}


def test_a_backend_gives_up_before_its_bridge_whatever_its_options_say() -> None:
    timeouts = Timeouts(10.0)
    spec = bridge_spec('m={"backend": "openai"}')
    assert _in_time(spec, {}, timeouts)["timeout_s"] == 9.5
    assert _in_time(spec, {"timeout_s": 300}, timeouts)["timeout_s"] == 9.5
    assert _in_time(spec, {"timeout_s": 2}, timeouts)["timeout_s"] == 2
