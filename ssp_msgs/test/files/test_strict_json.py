"""JSON from outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ssp_core.files.strict_json import MOST_LEVELS, parse_lenient, parse_strict


@pytest.mark.parametrize("parse", [parse_strict, parse_lenient])
def test_more_levels_of_json_than_can_be_walked_are_refused(parse: Callable[[str], Any]) -> None:
    """Python 3.12 and later read more of them than 3.11."""
    for opens, closes in (("[", "]"), ('{"a": ', "}")):
        at_most = opens * MOST_LEVELS + "1" + closes * MOST_LEVELS
        assert parse(at_most) is not None
        with pytest.raises((ValueError, RecursionError), match=r"levels|nested too deeply"):
            parse(f"[0, {at_most}]")
