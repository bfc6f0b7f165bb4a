"""A run over DDS whose terminal takes no lines."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run.over_dds import session as over_dds
from ssp_scenario_manager.run.over_dds.live import LiveSetup
from tests.support.processes.waiting import DEADLINE_S, until
from tests.support.runs import cut_in_run

LINES = ("phase approach", "trigger crossed")


class SessionStart(Exception):
    """Raised where the session is followed."""


def test_what_follows_a_session_waits_for_no_terminal_that_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next line after Ctrl-S held up the runner, which then heard no abort."""
    goes_on, said = threading.Event(), list[str]()

    def write(line: str) -> None:
        if line in LINES and not goes_on.wait(DEADLINE_S):
            return
        said.append(line)

    @contextmanager
    def group(*_: object) -> Iterator[MagicMock]:
        with ExitStack() as after_end:
            env = {"ROS_DOMAIN_ID": "0", "FASTRTPS_DEFAULT_PROFILES_FILE": "hosts.xml"}
            yield MagicMock(env=env, after_end=after_end)

    def follow(*given: Any) -> None:
        say, mark = given[4], given[-1]
        for line in LINES:
            say(line)
        is_read = mark()
        assert not is_read()
        assert not set(LINES) & set(said)
        goes_on.set()
        until(is_read, "the terminal to take the lines")
        raise SessionStart

    monkeypatch.setattr(over_dds, "_process_group", group)
    monkeypatch.setattr(over_dds, "follow", follow)
    run = RunSpec.model_validate({**cut_in_run(), "mode": "live"})
    with pytest.raises(SessionStart):
        over_dds.run_session(run, tmp_path, write, LiveSetup({}))
    assert tuple(said[-2:]) == LINES
