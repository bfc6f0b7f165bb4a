"""A real language model, with its weights, in the chain: it may be bad, and must do no harm.

SmolLM2-135M answers behind llama.cpp's server on this machine. Each test prints what it measured.
"""

from __future__ import annotations

import copy
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.chat.client import OpenAIChat, Policy
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.extract import extract
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.extract.measure import load_corpus, measure
from ssp_vla_bridge.backend import make_backend, respond
from ssp_vla_bridge.messages import EgoSample, Frame, Request

pytestmark = [pytest.mark.real_model, pytest.mark.timeout(7200)]
MODEL = "SmolLM2-135M"
SCENARIOS = ("cut_in", "vru_crossing")
CORPUS = Path(__file__).parents[2] / "ssp_eval" / "test" / "corpus" / "test.jsonl"
TEXTS = 60
# One core makes a few tokens a second where others keep the machine busy.
COMMAND_S, ANSWER_S = 3600.0, 600.0
# A trajectory of four points needs 60; slots whose length the grammar bounds at most 80 each.
TOKENS, TOKENS_OF_SLOTS = 120, 640
Show = Callable[[str], None]


@pytest.fixture
def show(capsys: pytest.CaptureFixture[str]) -> Show:
    """Print a line of measured figures, whatever becomes of the test."""

    def tell(line: str) -> None:
        with capsys.disabled():
            print(f"\n{line}", flush=True)

    return tell


@pytest.fixture
def ssp() -> Callable[..., None]:
    """A command of the command line, which must end with 0."""

    def run(*arguments: object) -> None:
        command = [sys.executable, "-m", "ssp_core.cli", *map(str, arguments)]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=COMMAND_S, check=False
        )
        assert done.returncode == 0, done.stderr

    return run


def test_both_scenarios_from_the_run_to_the_report(
    model_url: str, ssp: Callable[..., None], tmp_path: Path, show: Show
) -> None:
    out, begun_s = tmp_path / "out", time.monotonic()
    for name in SCENARIOS:
        ssp("run", name, "--seed", "1", "--out", tmp_path / name)
    recorded_s = time.monotonic()
    bridge = {
        "backend": "openai",
        "interface": "waypoints",
        "base_url": model_url,
        "model": MODEL,
        "images": "none",
        "max_tokens": TOKENS,
        "timeout_s": ANSWER_S,
    }
    bags = [tmp_path / name / "bag" for name in SCENARIOS]
    ssp(
        "evaluate",
        *bags,
        "--propose-labels",
        "--bridge",
        f"smollm2={json.dumps(bridge)}",
        "--timeout",
        ANSWER_S + 10.0,
        "--out",
        out,
    )
    asked_s = time.monotonic()
    ssp("report", out, "--tables", tmp_path / "tables")
    cells = {(cell.scenario, cell.model): cell for cell in load_cells(out)}
    shown = "smollm2+blind"
    for name in SCENARIOS:
        cell = cells[name, shown]
        assert (cell.facts.status, cell.is_blind, cell.is_control) == ("ok", True, True)
        assert cell.facts.model_ids == [MODEL]
        assert len(cell.records) == len(cell.labels.labels)
        told = {
            model: f"{of.score.ivcs:.3f}"
            for (scenario, model), of in cells.items()
            if scenario == name and of.score is not None
        }
        show(f"IVCS of {name}: {told}")
        show(f"its first answer: {cell.records[0].text!r}")
    assert shown in (out / "index.html").read_text()
    ended_s = time.monotonic()
    show(
        f"{recorded_s - begun_s:.0f} s to record, {asked_s - recorded_s:.0f} s to ask, "
        f"{ended_s - asked_s:.0f} s to report"
    )


def test_a_picture_is_refused_by_its_server_and_we_say_why(model_url: str, show: Show) -> None:
    options = {
        "base_url": model_url,
        "model": MODEL,
        "interface": "waypoints",
        "tries": 1,
        "timeout_s": ANSWER_S,
    }
    jpeg = cv2.imencode(".jpg", np.full((36, 64, 3), 128, np.uint8))[1].tobytes()
    history = (EgoSample(0.0, 0.0, 0.0, 0.0, 8.0, 0.0),)
    request = Request("r", 10**9, (Frame(10**9, jpeg),), None, history, "measured")
    response = respond(make_backend("openai", options), "smollm2", request).response
    show(response.error_msg)
    assert "the server says 500: image input is not supported" in response.error_msg
    assert "images: none" in response.error_msg
    blind = make_backend("openai", {**options, "images": "none", "max_tokens": 8})
    assert respond(blind, "smollm2", request).response.error_msg == ""


class Short:
    """A chat that holds the answers to short ones, as a bad model would go on for ever."""

    model = MODEL

    def __init__(self, url: str) -> None:
        self._chat = OpenAIChat(url, MODEL, None, Policy(timeout_s=ANSWER_S, tries=1))

    def ask(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        asked = copy.deepcopy({**answer, "max_completion_tokens": TOKENS_OF_SLOTS})
        for slot in asked["response_format"]["json_schema"]["schema"]["properties"].values():
            value = slot["anyOf"][1]
            if value["type"] == "array":
                value["maxItems"] = 2
                value = value["items"]
            value["properties"]["quote"]["maxLength"] = 40
        return self._chat.ask(messages, asked)


def test_extraction_is_hardly_less_precise_with_it(model_url: str, show: Show) -> None:
    """The texts have a slot that rules and reader leave empty; its grammar holds the schema."""
    without = Extractor()

    def empty(text: str) -> list[str]:
        slots = without(text).slots
        return [name for name in SLOT_NAMES if getattr(slots, name) is None]

    open_ones = [example for example in load_corpus(CORPUS) if empty(example.text)]
    chosen = open_ones[:: len(open_ones) // TEXTS][:TEXTS]
    # Questions about the same slots begin with the same words, which the server keeps.
    chosen.sort(key=lambda example: empty(example.text))
    found = {
        "rules": measure(chosen, extract).slots["all"],
        "rules and reader": measure(chosen, lambda text: without(text).slots).slots["all"],
    }
    extractor, begun_s = Extractor(Short(model_url)), time.monotonic()
    both = measure(chosen, lambda text: extractor(text).slots).slots["all"]
    took_s = time.monotonic() - begun_s
    for name, of in (*found.items(), ("with it", both)):
        show(f"{name}: precision {of.precision.value}, recall {of.recall.value}, {of}")
    show(f"{extractor.tally()}, {took_s:.0f} s for {TEXTS} texts")
    assert extractor.counts["asked"] == TEXTS
    assert both.precision.value is not None
    for name, of in found.items():
        assert of.precision.value is not None
        assert both.precision.value >= of.precision.value - 0.01, name
