"""The part of a model's output that counts as its answer (METHOD 5.4b): cases of corpus/.

A case is what a server says; the bridge reads it, the adapter and the rules make the record.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.chat.client import Reply
from ssp_eval.evaluate.store.answer_records import record_of
from ssp_vla_bridge.backend import make_backend, respond
from ssp_vla_bridge.messages import EgoSample, Frame, Request
from ssp_vla_bridge.trajectory import interpolate
from tests.support.rows import check_rows

CORPUS = Path(__file__).parents[1] / "corpus"
JPEG = cv2.imencode(".jpg", np.zeros((24, 32, 3), np.uint8))[1].tobytes()
TOLERANCE_M = 0.05
NEUTRAL = "Dry asphalt, grey sky."
STAGED = {"lightemma", "openemma"}
SPEED_MPS = 13.0
HISTORY = tuple(
    EgoSample(0.1 * (i - 60), SPEED_MPS * 0.1 * (i - 60), 0.0, 0.0, SPEED_MPS, 0.0)
    for i in range(61)
)


class Server:
    """Stands in the place of the chat client; answers each stage as a case says."""

    def __init__(self, case: dict[str, Any]) -> None:
        self._case, self.prompts = case, []

    def request(self, messages: Any, parameters: Any, deadline_s: float | None = None) -> Reply:
        case = self._case
        self.prompts.append(json.dumps(messages, ensure_ascii=False))
        motion = case["interface"] not in STAGED or self.prompts[-1].count(NEUTRAL[:20]) >= 2
        text = case["answer"] if motion else case.get("stages", NEUTRAL)
        message = {"role": "assistant", "content": text}
        reason = case["finish_reason"] if motion else "stop"
        choice = {"index": 0, "message": message, "finish_reason": reason}
        body = {"model": "m", "choices": [choice]}
        if motion:
            message.update(case.get("message", {}))
            choice.update(case.get("choice", {}))
            body.update(case.get("body", {}))
        return Reply(json.dumps(body).encode(), 1)


def answered(case, tmp_path):
    """The response to a case's request, the request, and the prompts that were sent."""
    options = case.get("options", {})
    if "points" in case:
        name = f"planner_{case['id'].replace('-', '_')}"
        module = tmp_path / f"{name}.py"
        module.write_text(f"def drive(request): return {case['answer']!r}, {case['points']!r}\n")
        given = {"function": f"{name}:drive", "folder": str(tmp_path), **options}
        backend, prompts = make_backend("python", given), []
    else:
        given = {"base_url": "http://127.0.0.1:9/v1", "model": "m", "tries": 1, **options}
        backend = make_backend("openai", {**given, "interface": case["interface"]})
        server = Server(case)
        backend._chat, prompts = server, server.prompts
    frames = (Frame(10**10, JPEG),)
    request = Request("r1", 10**10, frames, None, HISTORY, "measured")
    return respond(backend, "m", request).response, request, prompts


def alternatives(expected: str) -> list[str]:
    return expected.lower().split("|")


def test_each_answer_is_read_as_it_was_meant(tmp_path):
    cases = [
        json.loads(line)
        for name in ("answers.jsonl", "answer_kinds.jsonl")
        for line in (CORPUS / name).read_text().splitlines()
    ]
    assert len({case["id"] for case in cases}) == len(cases)
    check_rows(lambda case: check_answer(case, tmp_path), [(case,) for case in cases])


def check_answer(case, tmp_path):
    expect = case["expect"]
    response, request, prompts = answered(case, tmp_path)
    if expect.get("error"):
        assert response.error_code
        return
    assert not response.error_code, response.error_msg
    record = record_of(1.0, response, case["interface"], request)
    if "trajectory" in expect:
        wanted = expect["trajectory"]
        assert (record.trajectory is None) == (wanted is None), (record.invalid, record.adapter)
        for t_s, x_m, y_m in wanted or ():
            assert interpolate(record.trajectory, t_s) == pytest.approx((x_m, y_m), abs=TOLERANCE_M)
    if "invalid" in expect and record.trajectory is None:
        assert set(alternatives(expect["invalid"])) & set(record.invalid)
    notes = [*record.adapter["notes"], *response.decoding.get("notes", [])]
    if "note_contains" in expect:
        assert any(
            word in note.lower() for note in notes for word in alternatives(expect["note_contains"])
        ), notes
    for name, wanted in expect.get("slots", {}).items():
        slot = getattr(record.slots, name)
        found = None if slot is None else slot.value
        allowed = wanted["any"] if isinstance(wanted, dict) else [wanted]
        assert found in [tuple(one) if isinstance(one, list) else one for one in allowed], name
    if "prompts_lack" in expect:
        assert not any(expect["prompts_lack"] in prompt for prompt in prompts)
