"""Checks of ``ssp doctor`` that need no more than a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.leap_seconds import day_ns
from ssp_scenario_manager.doctor.checks import (
    Status,
    environment,
    leap_seconds_table,
    one_checkout,
)

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


def test_the_environment_has_a_row_for_each_wrong_variable() -> None:
    wrong = {"ROS_DOMAIN_ID": "abc", "ROS_DISCOVERY_SERVER": "127.0.0.1:11811", "LANG": "C"}
    found = environment(wrong, lambda *_: True)
    assert [finding.status for finding in found] == [Status.FAIL, Status.FAIL]
    for finding, words in zip(found, ("ROS_DOMAIN_ID=abc", "ROS_DISCOVERY_SERVER="), strict=True):
        assert finding.text.startswith(words)
        assert finding.remedy


def test_the_environment_names_what_a_live_session_uses() -> None:
    env = {"ROS_DOMAIN_ID": "7", "SSP_PYTHONPATH": "/mine", "HTTPS_PROXY": "http://x"}
    (found,) = environment(env, lambda *_: False)
    assert found.status is Status.OK
    assert "ROS_DOMAIN_ID=7" in found.text
    assert "/mine" in found.text
    assert "HTTPS_PROXY" not in found.text


def test_packages_of_two_checkouts_are_told(tmp_path: Path) -> None:
    for root in ("a", "b"):
        for folder in ("ssp_msgs/ssp_core", "ssp_eval/ssp_eval"):
            (tmp_path / root / folder).mkdir(parents=True)
            (tmp_path / root / folder).parent.joinpath("package.xml").touch()
    a = {
        "ssp_core": tmp_path / "a" / "ssp_msgs" / "ssp_core",
        "ssp_eval": tmp_path / "a" / "ssp_eval" / "ssp_eval",
    }
    assert one_checkout(a).status is Status.OK
    mixed = a | {"ssp_eval": tmp_path / "b" / "ssp_eval" / "ssp_eval"}
    found = one_checkout(mixed)
    assert found.status is Status.FAIL
    assert str(tmp_path / "b") in found.text


@pytest.mark.parametrize("isolated", [False, True])
def test_a_workspace_is_one_whether_its_packages_are_merged_or_not(
    tmp_path: Path, isolated: bool
) -> None:
    def place(package: str, name: str) -> Path:
        prefix = tmp_path / "install" / package if isolated else tmp_path / "install"
        return prefix / "lib" / "python3.12" / "site-packages" / name

    places = {"ssp_core": place("ssp_msgs", "ssp_core"), "ssp_eval": place("ssp_eval", "ssp_eval")}
    assert one_checkout(places).status is Status.OK
