"""A person's word on a session is of the day on which the bag was recorded."""

from __future__ import annotations

from datetime import UTC, date, datetime
from pathlib import Path

import pytest

from ssp_core.bag.seals.declaration import DECLARATION_FILE, Declaration, seal_declaration
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.steps import encode_clock
from ssp_core.errors import InputError

DAY = date(2026, 3, 2)
NOON_NS = int(datetime(2026, 3, 2, 12, tzinfo=UTC).timestamp()) * 10**9


def word(day: date) -> Declaration:
    said = {"kind": "real", "device": "car", "serial": "AB 12"}
    return Declaration.model_validate(
        {"who": "A. Engineer", "date": day, "place": "north track", "participants": {"vut": said}}
    )


def recorded(folder: Path, stamp_ns: int) -> Path:
    with BagWriter(folder) as writer:
        writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        writer.write("/clock", encode_clock(stamp_ns % 10**18), stamp_ns, stamp_ns)
    return folder


@pytest.mark.parametrize("days", [-1, 0, 1])
def test_the_day_of_the_session_is_taken_wherever_it_was(tmp_path: Path, days: int) -> None:
    bag = recorded(tmp_path / "bag", NOON_NS)
    assert seal_declaration(word(DAY.replace(day=DAY.day + days)), bag).is_file()


@pytest.mark.parametrize("day", [date(2026, 3, 5), date(2025, 3, 2), date(2031, 1, 1)])
def test_another_day_is_refused(tmp_path: Path, day: date) -> None:
    bag = recorded(tmp_path / "bag", NOON_NS)
    with pytest.raises(InputError, match="the bag was recorded on 2026-03-02") as refused:
        seal_declaration(word(day), bag)
    assert (refused.value.field, refused.value.value) == ("date", str(day))
    assert not (bag / DECLARATION_FILE).exists()


def test_a_clock_that_was_never_set_says_no_day(tmp_path: Path) -> None:
    assert seal_declaration(word(DAY), recorded(tmp_path / "bag", 5 * 10**9)).is_file()
