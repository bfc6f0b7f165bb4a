"""A campaign whose slots come from rules and an LLM."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_eval.data.records import load_records
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients, ModelClient
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers, ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec, bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.extract import extractor_hash
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.extract.reader.reader import reader_hash
from ssp_vla_bridge.messages import Request
from tests.support.models.llm_server import GOOD, TEXT, answering, extractor, serving


class Worded:
    """A model that drives as constant_velocity does, and says TEXT."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        self.inner = InProcessClients().client(model, options)
        return self

    @property
    def ignored(self) -> IgnoredAnswers:
        return IgnoredAnswers()

    def ask(self, request: Request) -> ModelReply:
        reply = self.inner.ask(request)
        assert reply.response is not None
        return replace(reply, response=replace(reply.response, text=TEXT))


@pytest.mark.parametrize(
    "given", [["--llm", "m"], ["--llm-base-url", "http://localhost:1/v1"], ["--llm-cache", "kept"]]
)
def test_the_options_of_a_campaign_belong_together(
    given: list[str], make_bag: Callable[..., Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = ["evaluate", str(make_bag()), "--bridge", "constant_velocity", "--out", str(out)]
    assert main([*command, *given]) == 2
    assert not out.exists()


def test_a_campaign_says_what_the_llm_did_and_asks_once_for_a_text(
    make_bag: Callable[..., Path], tmp_path: Path
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    models = [bridge_spec("constant_velocity")]

    def run(asked: Extractor) -> tuple[dict[str, Any], bytes]:
        options = CellOptions(extractor=asked)
        (result,) = run_campaign([(bag, None)], models, Worded(), out, options, True)
        assert result.status == "ok"
        cell = json.loads((result.folder / "cell.json").read_text())
        return cell, (result.folder / "records.jsonl").read_bytes()

    plain, without = run(Extractor(use_reader=False))
    assert plain["hashes"]["extractor"] == extractor_hash()
    assert plain["extraction"] == {"rules": extractor_hash(), "reader": None, "llm": None}
    read, _ = run(Extractor())
    assert read["hashes"]["extractor"] == Extractor().sha256 != extractor_hash()
    assert read["extraction"]["reader"]["weights"] == reader_hash()
    counts = {"slots_given": 0, "reader_filled": 0, "reader_withdrawn": 0}  # none is in this text
    assert read["extraction"]["reader"]["counts"] == counts
    with serving(answering(GOOD)) as server:
        asked = extractor(server.url, tmp_path / "kept")
        cell, first = run(asked)
        again, second = run(extractor(server.url, tmp_path / "kept"))
        assert len(server.requests) == 1  # every answer has the same text
    assert cell["hashes"]["extractor"] == asked.sha256 != extractor_hash()
    assert cell["extraction"]["llm"]["counts"]["asked"] == 1
    assert again["extraction"]["llm"]["counts"]["asked"] == 0
    assert second == first != without
    for record in load_records(out / "cells" / cell_name(out) / "records.jsonl"):
        assert record.slots.motion is not None
        assert record.adapter is not None
        assert any("slots by the LLM" in note for note in record.adapter["notes"])


def cell_name(out: Path) -> str:
    (folder,) = (out / "cells").iterdir()
    return folder.name
