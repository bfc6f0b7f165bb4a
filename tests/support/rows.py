"""Tables whose rows one test checks, where each row would be a test that takes milliseconds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest

# So much of a row names it in a failure.
_MOST_CHARACTERS = 300


def check_rows(check: Callable[..., object], rows: Iterable[Sequence[Any]]) -> None:
    """Call a check with the values of each row, and fail once for all rows that fail.

    Args:
        check: raises for a row that is wrong.
        rows: at least one.
    """
    count, wrong = 0, []
    for row in rows:
        count += 1
        try:
            check(*row)
        except (Exception, pytest.fail.Exception) as error:
            wrong.append(f"{repr(row)[:_MOST_CHARACTERS]}\n{type(error).__name__}: {error}")
    if not count:
        pytest.fail("the table has no rows")
    if wrong:
        pytest.fail(f"{len(wrong)} of {count} rows fail:\n\n" + "\n\n".join(wrong), pytrace=False)
