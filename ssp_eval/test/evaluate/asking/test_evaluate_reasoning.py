"""The model's own text given back, as conditions of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import pytest

from ssp_core.cli import main
from ssp_eval.evaluate.campaign import Plan, run_campaign
from ssp_eval.evaluate.cli import reasoned
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec, attached_spec, condition_of
from ssp_eval.evaluate.conditions.expansion import (
    with_controls,
    with_pictures,
    with_reasoning,
    with_twin_conditions,
)
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_vla_bridge.backends.given_back import FACTS
from ssp_vla_bridge.messages import Request, Response
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
OPTIONS = {"base_url": "http://127.0.0.1:9/v1", "model": "seer-7b", "interface": "waypoints"}
CHAT = ModelSpec("chat", OPTIONS, backend="openai")
SEEING = ModelSpec("seeing", backend="opencv_baseline")
SHOWN = [f"chat+reasoning.{fact}" for fact in FACTS]


class Noting(Answering):
    """Answers with what its model was to be given back."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> Any:
        self.fact = str(options.get("give_back", "nothing"))
        return self

    def ask(self, request: Request) -> ModelReply:
        self.requests.append(request)
        text = f"given {self.fact}"
        return ModelReply(Response(request.request_id, request.stamp_ns, "chat", "s/1", text))


def test_a_model_is_asked_with_each_fact_turned_and_with_none() -> None:
    models = with_reasoning(with_pictures(with_controls([SEEING, CHAT])))
    added = [model for model in models if model.condition.startswith("reasoning.")]
    assert [model.result_name for model in added] == SHOWN
    assert [model.options for model in added] == [{**OPTIONS, "give_back": f} for f in FACTS]
    assert all(model.control for model in added)
    assert [condition_of(name) for name in SHOWN] == [
        ("chat", f"reasoning.{fact}") for fact in FACTS
    ]
    # What is asked of it otherwise stays as it was.
    others = [m for m in with_twin_conditions(models, ["twin.control.car"]) if m not in added]
    assert all("give_back" not in model.options for model in others)


def test_a_campaign_tells_the_backend_what_to_give_back(make_bag: BagMaker, tmp_path: Path) -> None:
    client, told = Noting(), list[Plan]()
    bags: list[tuple[Path, Path | None]] = [(make_bag(), None)]
    models = reasoned([CHAT])
    results = run_campaign(bags, models, client, tmp_path, CellOptions(), True, on_plan=told.append)
    assert [result.model for result in results] == ["chat", *SHOWN, "chat+repeat"]
    assert told == [Plan(54, 6, 54, 0, 0, given_back=36, repeated=9)]
    assert "of these 36 with the model's own text given back; 9 as before" in told[0].line()
    said = {cell.model: {record.text for record in cell.records} for cell in load_cells(tmp_path)}
    assert said["chat"] == said["chat+repeat"] == {"given nothing"}
    assert [said[name] for name in SHOWN] == [{f"given {fact}"} for fact in FACTS]
    # The same frames and history each time: only the bridge knows of it.
    frames = [[frame.sha256 for frame in request.frames] for request in client.requests]
    assert frames == frames[:9] * 6
    again = run_campaign(bags, models, client, tmp_path, CellOptions())
    assert [(result.sent, result.reused) for result in again] == [(0, 9)] * 6


def test_who_can_t_be_given_its_text_is_named(capfd: pytest.CaptureFixture[str]) -> None:
    assert [model.result_name for model in reasoned([SEEING, CHAT])] == ["seeing", "chat", *SHOWN]
    assert "reasoning of seeing: n/a" in capfd.readouterr().err
    for models in ([SEEING], [attached_spec("chat")]):
        with pytest.raises(click.UsageError, match="needs the backend openai"):
            reasoned(models)


def test_the_command_refuses_it_for_models_without_a_text(tmp_path: Path) -> None:
    command = ["evaluate", str(tmp_path), "--bridge", "constant_velocity", "--out", str(tmp_path)]
    assert main([*command, "--reasoning"]) == 2
