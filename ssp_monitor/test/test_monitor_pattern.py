"""Expressions over topic names: the same answers as ``re``, in linear time."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_monitor.recorder.pattern import Pattern

_ATOMS = st.sampled_from(
    ["a", "b", "/", "_", ".", "[ab]", "[^a]", "[a-c/]", "\\d", "\\w", "\\W", "\\.", "[\\d_]"]
)


def _grown(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.one_of(
        st.tuples(inner, inner).map("".join),
        st.tuples(inner, inner).map(lambda two: f"(?:{two[0]}|{two[1]})"),
        st.tuples(inner, st.sampled_from("*+?")).map(lambda two: f"({two[0]}){two[1]}"),
    )


_EXPRESSIONS = st.recursive(_ATOMS, _grown, max_leaves=8)
_ENDS = st.sampled_from(["", "^"]), st.sampled_from(["", "$"])


@given(*_ENDS, _EXPRESSIONS, st.lists(st.text("abc/_.1-", max_size=12), max_size=8))
def test_it_finds_what_re_finds(start: str, end: str, middle: str, names: list[str]) -> None:
    text = f"{start}(?:{middle}){end}"
    pattern = Pattern(text, "--include")
    for name in names:
        assert pattern.found_in(name) == (re.search(text, name) is not None), (text, name)


@pytest.mark.parametrize(
    "text",
    ["(", ")", "a)", "(a", "[a", "[", "*", "a**", "+a", "a|*", "(?P<x>a)", "(?=a)", "\\1", "\\b",
     "a\\", "a{2}", "[b-a]", "[^\\D]", "(" * 60 + ")" * 60, "a" * 1001],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--exclude"):
        Pattern(text, "--exclude")


@given(st.text(max_size=30))
def test_any_text_is_an_expression_or_an_input_error(text: str) -> None:
    try:
        pattern = Pattern(text, "x")
    except InputError:
        return
    assert pattern.found_in("/ssp/vut/state") in (True, False)


def test_expressions_that_bring_re_to_its_knees_take_a_step_per_character() -> None:
    pattern = Pattern("^(a+)+(a|aa)*(.*a)*x$", "--include")
    assert not pattern.found_in("a" * 20_000)
    assert pattern.found_in("a" * 20_000 + "x")
    # The steps that it remembers don't grow with the name.
    assert len(pattern._steps) < 50


def test_remembered_steps_are_bounded() -> None:
    pattern = Pattern("(a|b)*a" + "(a|b)" * 14, "--include")
    assert not pattern.found_in("b" * 30)
    for number in range(4000):
        pattern.found_in(f"{number:015b}".replace("0", "a").replace("1", "b") * 2)
        assert len(pattern._steps) <= 2000


def test_the_ends_are_no_characters_of_a_name() -> None:
    assert Pattern("^/a", "x").found_in("/a/b")
    assert not Pattern("^/a", "x").found_in("/b/a")
    assert not Pattern(".", "x").found_in("")
    assert Pattern("^$", "x").found_in("")
    assert not Pattern("a", "x").found_in("a\x03")
