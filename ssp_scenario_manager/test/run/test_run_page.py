"""The operators' page beside a run: its announced address, and that it never delays the run."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from textwrap import indent

import pytest
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_core.host.processes import ProcessGroup
from ssp_core.run_file.verdict import EndWord
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.cli.run import run
from ssp_scenario_manager.run.over_dds import companions
from tests.support.processes.waiting import until

STAND_IN = """
import os, sys, time
print("page: http://127.0.0.1:4711/", flush=True)
assert len(os.environ["SSP_PAGE_TOKEN"]) > 30 and os.environ["SSP_PAGE_TOKEN"] not in sys.argv
if "run_file:=die" in sys.argv:
    raise SystemExit("port 4711 is taken")
time.sleep(600)
"""
# Ends only what hangs.


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProcessGroup:
    """A session without processes; the page is a stand-in that says where it is."""
    write_page(tmp_path, STAND_IN)
    monkeypatch.setattr(companions, "PAGE_MODULE", "stand_in_page")
    monkeypatch.delenv("SSP_PAGE_TOKEN", raising=False)
    env = {**os.environ, "ROS_DOMAIN_ID": "0", "PYTHONPATH": str(tmp_path)}
    (tmp_path / "logs").mkdir()
    return ProcessGroup(env, tmp_path / "logs", owns_domain=False)


def write_page(folder: Path, text: str) -> None:
    """A stand-in of the page, by what its process does."""
    (folder / "stand_in_page.py").write_text(f"def main():\n{indent(text, '    ')}")


def wait_for_line(said: list[str], part: str) -> None:
    until(lambda: any(part in line for line in said), lambda: f"{part!r} in {said}")


def beside(
    session: ProcessGroup, run_file: str, said: list[str]
) -> AbstractContextManager[Callable[[EndWord], None]]:
    page = companions.page_companion(session.env, Path(run_file), 0)
    return companions.beside(session, [page], said.append)


def test_says_where_it_is_with_the_token_that_no_log_has(session: ProcessGroup) -> None:
    said: list[str] = []
    with beside(session, "run.yaml", said):
        wait_for_line(said, "operator page: ")
        assert not session.processes  # nobody who watches the session's processes sees it
    (line,) = said
    address, _, token = line.partition("#token=")
    assert address == "operator page: http://127.0.0.1:4711/"
    assert len(token) >= 32
    assert token not in (session.log_dir / "monitor_page.log").read_text()
    assert "SSP_PAGE_TOKEN" not in session.env


def test_a_token_that_was_given_is_kept_and_not_shown(session: ProcessGroup) -> None:
    token = "chosen-by-the-operator-and-kept-in-all-tabs"
    session.env["SSP_PAGE_TOKEN"] = token
    write_page(
        session.log_dir.parent,
        f"import os, time\nassert os.environ['SSP_PAGE_TOKEN'] == {token!r}\n"
        "print('page: http://127.0.0.1:4711/', flush=True)\ntime.sleep(600)\n",
    )
    said: list[str] = []
    with beside(session, "run.yaml", said):
        wait_for_line(said, "operator page: ")
    assert said == ["operator page: http://127.0.0.1:4711/"]


@pytest.mark.parametrize("token", ["short", "ä" * 20, "with spaces in between it"])
def test_a_token_that_can_be_none_is_refused(session: ProcessGroup, token: str) -> None:
    session.env["SSP_PAGE_TOKEN"] = token
    with pytest.raises(InputError, match="SSP_PAGE_TOKEN") as refused:
        companions.page_companion(session.env, Path("run.yaml"), 0)
    assert token not in str(refused.value)
    assert not list(session.log_dir.iterdir())


def test_a_wrong_token_is_said_before_a_run_starts(tmp_path: Path) -> None:
    env = {"SSP_PAGE_TOKEN": "short"}
    where = ["--out", str(tmp_path / "out")]
    done = CliRunner().invoke(run, ["cut_in", "--page", "0", *where], env=env)
    assert done.exit_code == 2 or isinstance(done.exception, InputError), done.output
    assert "SSP_PAGE_TOKEN" in f"{done.output}{done.exception}"
    assert not list(tmp_path.rglob("logs"))


def test_an_end_of_its_own_is_said_and_no_more(session: ProcessGroup) -> None:
    said: list[str] = []
    with beside(session, "die", said):
        wait_for_line(said, "exited")
    assert "the operator page exited with status 1; the session goes on without it" in said[-1]
    assert "port 4711 is taken" in said[-1]


# Says what it hears, and stays where it is wanted to.
HEARING = """
import sys, time
print("page: http://127.0.0.1:4711/", flush=True)
for line in sys.stdin:
    print("heard", line, end="", flush=True)
    if '"final": true' in line and "run_file:=stay" in sys.argv:
        print("page: stays for its viewers", flush=True)
        time.sleep(600)
print("gone", flush=True)
"""


@pytest.mark.parametrize("stays", [False, True])
def test_a_page_that_is_told_the_end_may_stay_and_is_not_waited_for(
    session: ProcessGroup, stays: bool
) -> None:
    write_page(session.log_dir.parent, HEARING)
    said: list[str] = []
    with beside(session, "stay" if stays else "run.yaml", said) as tell:
        wait_for_line(said, "operator page: ")
        for final in (False, True):
            tell(EndWord(Verdict.VALID, (), final))
    log = (session.log_dir / "monitor_page.log").read_text()
    assert log.count("heard") == 2
    found = re.search(r"`kill (\d+)` ends it now", said[-1])
    assert (found is not None) is stays
    if found is not None:
        os.kill(int(found[1]), signal.SIGKILL)
    assert not any("exited" in line for line in said)


# Hears its runner until the end; then it hangs, or is slow to close.
HANGING = """
import os, signal, sys, time
print("page: http://127.0.0.1:4711/", flush=True)
for line in sys.stdin:
    if '"final": true' in line:
        if "run_file:=slow" in sys.argv:
            print("page: heard the end", flush=True)
            time.sleep(600)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        os.kill(os.getpid(), signal.SIGSTOP)
"""


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("hangs", "operator page: didn't hear the end within 2 s, and was ended"),
        ("slow", "operator page: hasn't closed yet; `kill -9 "),
    ],
)
def test_a_page_that_hangs_holds_up_no_verdict(
    session: ProcessGroup, kind: str, words: str
) -> None:
    write_page(session.log_dir.parent, HANGING)
    said: list[str] = []
    with beside(session, kind, said) as tell:
        wait_for_line(said, "operator page: ")
        told_s = time.monotonic()
        tell(EndWord(Verdict.VALID, (), True))
    assert time.monotonic() - told_s < 10.0
    assert said[1].startswith(words)
    found = re.search(r"kill -9 (\d+)", said[1])
    assert (found is not None) is (kind == "slow")
    if found is not None:
        os.kill(int(found[1]), signal.SIGKILL)
    assert len(said) == 2


def test_a_page_that_is_told_no_end_ends_with_the_run(session: ProcessGroup) -> None:
    write_page(session.log_dir.parent, HEARING)
    said: list[str] = []
    with beside(session, "stay", said) as tell:
        wait_for_line(said, "operator page: ")
        tell(EndWord(Verdict.VALID, (), False))
    assert len(said) == 1


def test_one_process_has_no_page() -> None:
    done = CliRunner().invoke(run, ["cut_in", "--in-process", "--page"])
    assert done.exit_code == 2
    assert "leave out --page" in done.output


def test_a_port_is_a_port() -> None:
    done = CliRunner().invoke(run, ["cut_in", "--page", "70000"])
    assert done.exit_code == 2
    assert "70000" in done.output
