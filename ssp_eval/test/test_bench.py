"""``ssp bench`` says beside each figure whether its limit is kept, and ends accordingly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ssp_eval import checkout

ROOT = Path(__file__).resolve().parents[2]
FIGURE = {
    "name": "path", "ours": 2.0, "bound": 1.0, "unit": "ms", "ratio": 2.0, "limit": None,
    "kept": True, "note": "n",
}  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "status", "words"),
    [
        ({}, 0, []),
        ({"limit": "ratio <= 3"}, 0, ["ratio <= 3", "ok"]),
        ({"limit": "ratio <= 1.5", "kept": False}, 1, ["ratio <= 1.5", "not ok"]),
        ({"bound": None, "ratio": None, "limit": "<= 5 ms"}, 0, ["<= 5 ms", "ok"]),
    ],
)
def test_a_limit_that_is_not_kept_ends_with_status_1(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    changed: dict[str, Any],
    status: int,
    words: list[str],
) -> None:
    monkeypatch.setenv("SSP_ROOT", str(ROOT))
    monkeypatch.setattr(checkout, "run_benchmark", lambda folder, name: [FIGURE | changed])
    run = checkout.bench.callback
    assert run is not None
    assert run(("dispatch",), False) == status
    shown = " ".join(capsys.readouterr().out.split())
    for word in words:
        assert word in shown
    assert ("ok" in shown) == bool(words)
    assert run(("dispatch",), True) == status
    assert json.loads(capsys.readouterr().out) == FIGURE | changed
