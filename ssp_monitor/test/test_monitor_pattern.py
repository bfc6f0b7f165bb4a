"""Expressions over topic names."""

from __future__ import annotations

import warnings

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_monitor.recorder.topics import Pattern


@pytest.mark.parametrize(
    "text",
    ["(", ")", "a)", "(a", "[a", "[", "*", "a**", "+a", "a|*", "\\1", "a\\", "[b-a]", "a" * 1001,
     "(" * 500 + ")" * 500, "a{99999999999}"],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--exclude"):
        Pattern(text, "--exclude")


@given(st.text(max_size=30))
def test_any_text_is_an_expression_or_an_input_error(text: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # what re says of [[
        try:
            pattern = Pattern(text, "x")
        except InputError:
            return
    assert pattern.found_in("/ssp/vut/state") in (True, False)


def test_an_expression_may_match_anywhere_unless_it_names_an_end() -> None:
    assert Pattern("/b", "x").found_in("/a/b")
    assert Pattern("^/a", "x").found_in("/a/b")
    assert not Pattern("^/a", "x").found_in("/b/a")
    assert not Pattern(".", "x").found_in("")
    assert Pattern("^$", "x").found_in("")


def test_digits_and_words_are_those_of_ros_names() -> None:
    assert not Pattern("\\d|\\w", "x").found_in("\u0663\u00e9")
