"""Numbers as people and programs write them."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from ssp_core.cli import VERBS, cli
from ssp_core.decimals import decimal, whole_number
from ssp_core.options import WholeNumber


@pytest.mark.parametrize(
    ("text", "value"),
    [("10", 10.0), (" -1.5 ", -1.5), ("+.5", 0.5), ("5.", 5.0), ("1.1e+2", 110.0), ("007.50", 7.5)],
)
def test_decimal_numbers_are_read(text: str, value: float) -> None:
    assert decimal(text) == value


@pytest.mark.parametrize(
    "text",
    ["1_000", "1_0.5", "1,5", "1 000", "\uff11\uff12", "inf", "nan", "0x1F", "1e", "", "12:30"],
)
def test_what_python_or_a_person_alone_reads_is_no_number(text: str) -> None:
    with pytest.raises(ValueError, match="is no decimal number"):
        decimal(text)
    with pytest.raises(ValueError, match="is no whole number"):
        whole_number(text)


def test_an_option_for_a_whole_number_takes_digits_within_its_range() -> None:
    option = WholeNumber(0, 5000)
    assert option.convert("0040", None, None) == 40
    assert option.convert(7, None, None) == 7
    for text in ("1_000", "\uff11\uff12", "1.0", "1e3", ""):
        with pytest.raises(click.BadParameter, match="is no whole number"):
            option.convert(text, None, None)
    with pytest.raises(click.BadParameter, match="is not in the range"):
        option.convert("5001", None, None)


def _commands(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            yield from _commands(inner, f"{name} {inner.name}")


@pytest.mark.parametrize("verb", VERBS)
def test_no_option_of_any_verb_reads_numbers_by_pythons_rules(verb: str) -> None:
    found = cli.get_command(click.Context(cli), verb)
    assert found is not None
    for name, command in _commands(found, verb):
        for one in command.params:
            types = one.type.types if isinstance(one.type, click.Tuple) else (one.type,)
            for kind in types:
                wrong = isinstance(kind, click.types.IntParamType) and not isinstance(
                    kind, WholeNumber
                )
                assert not wrong, (name, one.name)
                assert not isinstance(kind, click.types.FloatParamType), (name, one.name)
