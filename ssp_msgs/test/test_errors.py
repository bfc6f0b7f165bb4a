"""Messages of errors: file, line, field, problem, value and remedy, in this order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import HostError, InputError, PeerError, SspError


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({}, "is wrong"),
        ({"file": Path("a.yaml")}, "a.yaml: is wrong"),
        ({"file": "a.yaml", "line": 3}, "a.yaml:3: is wrong"),
        ({"line": 3}, "line 3: is wrong"),
        ({"field": "x[1].y"}, "x[1].y: is wrong"),
        ({"file": "a.yaml", "field": "x", "value": 5}, "a.yaml: x: is wrong (got 5)"),
        ({"value": ""}, "is wrong (got '')"),
        ({"value": 0, "remedy": "give 1"}, "is wrong (got 0); give 1"),
    ],
)
def test_message(place: dict[str, Any], text: str) -> None:
    assert str(InputError("is wrong", **place)) == text


def test_long_values_are_shortened() -> None:
    message = str(InputError("is wrong", value="x" * 1000))
    assert len(message) < 150
    assert message.endswith("...)")


def test_one_tree() -> None:
    for kind in (InputError, PeerError, HostError):
        assert issubclass(kind, SspError)
    assert not issubclass(SspError, ValueError)
