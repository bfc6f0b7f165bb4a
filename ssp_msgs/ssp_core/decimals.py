"""Numbers in tables, maps and options, as people and other programs write them.

Python reads more: `1_000` as 1000, digits of other scripts, `infinity`. Where a number is wanted,
none of these is one.
"""

from __future__ import annotations

import re

_DECIMAL = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_WHOLE = re.compile(r"[-+]?[0-9]+")


def decimal(text: str) -> float:
    """Read a decimal number, with or without an exponent, blanks around it.

    Raises:
        ValueError: it is none; NaN and infinity are none.
    """
    if not _DECIMAL.fullmatch(text.strip()):
        raise ValueError(f"{text[:40]!r} is no decimal number")
    return float(text)


def whole_number(text: str) -> int:
    """Read a whole number in digits, blanks around it.

    Raises:
        ValueError: it is none.
    """
    if not _WHOLE.fullmatch(text.strip()):
        raise ValueError(f"{text[:40]!r} is no whole number")
    return int(text)
