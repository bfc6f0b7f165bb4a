"""Checks of ``ssp doctor`` that need no more than a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.leap_seconds import day_ns
from ssp_scenario_manager.doctor.checks import Status, leap_seconds_table

# As tzdata ships it; expires on 2027-06-28.
LISTED = """#	comment
#$	 3960835200
#@	4023129600
#
3644697600      36    # 1 Jul 2015
3692217600      37    # 1 Jan 2017
"""


def status(day: str, listed: Path) -> Status:
    return leap_seconds_table(day_ns(day), listed).status


def test_a_table_that_is_good_needs_no_list(tmp_path: Path) -> None:
    assert status("2026-06-27", tmp_path / "none") is Status.OK


def test_an_old_table_is_held_against_the_hosts_list(tmp_path: Path) -> None:
    listed = tmp_path / "leap-seconds.list"
    listed.write_text(LISTED)
    assert status("2026-11-01", listed) is Status.OK
    listed.write_text(LISTED + "4007750400      38    # 1 Jan 2027\n")
    assert status("2026-12-31", listed) is Status.OK
    found = leap_seconds_table(day_ns("2027-01-01"), listed)
    assert (found.status, found.text) == (Status.FAIL, f"18 s, but 19 s by {listed}")


@pytest.mark.parametrize("text", [None, "", "#@", "#@\tsoon", LISTED, "3692217600\t37\n"])
def test_an_old_table_without_a_newer_list_is_told_with_its_date(
    tmp_path: Path, text: str | None
) -> None:
    listed = tmp_path / "leap-seconds.list"
    if text is not None:
        listed.write_text(text)
    found = leap_seconds_table(day_ns("2027-06-28"), listed)
    assert found.status is Status.WARN
    assert "good until 2026-06-28" in found.text
    assert "tzdata" in found.remedy
