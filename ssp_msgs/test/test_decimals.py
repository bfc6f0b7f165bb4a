"""Numbers as people and programs write them."""

from __future__ import annotations

import pytest

from ssp_core.decimals import decimal, whole_number


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
