"""A closed terminal, a wish to end, output without a reader: each is answered in order."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from ssp_core.host.terminal import LineWriter
from tests.support.processes.waiting import DEADLINE_S, until

PROGRAM = """
import os, signal, sys
from ssp_core.host import terminal
{before}
# Not print: the signal may come while the main program is in one.
terminal.catch_stop_signals(lambda number: os.write(1, (number.name + chr(10)).encode()))
print("up", flush=True)
for _ in sys.stdin:
    print("after", flush=True)
"""
ENDS = ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"]


def program(before: str = "") -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(before=before)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        # Whatever started these tests may ignore some.
        preexec_fn=lambda: [signal.signal(getattr(signal, name), signal.SIG_DFL) for name in ENDS],
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    return process


def signal_words(process: subprocess.Popen[str], *numbers: str) -> list[str]:
    """Send signals one at a time, and return what the process says of them until its input ends."""
    said = []
    assert process.stdin is not None
    assert process.stdout is not None
    for number in numbers:
        process.send_signal(getattr(signal, number))
        process.stdin.write("\n")
        process.stdin.flush()
        while (line := process.stdout.readline().strip()) != "after":
            said.append(line)
            assert line, f"ended with {process.wait()}"
    process.stdin.close()
    # A signal that came just before it read is told behind "after".
    said += process.stdout.read().split()
    assert process.wait(600) == 0
    process.stdout.close()
    return [word for word in said if word != "after"]


@pytest.mark.parametrize("name", ENDS)
def test_each_wish_to_end_is_heard_and_its_echo_isn_t(name: str) -> None:
    soon = "terminal._SAME_WISH_S = 1e9"  # however busy the host is
    assert signal_words(program(soon), name, name, "SIGTERM") == [name]


def test_who_insists_is_heard_again_but_no_closed_terminal() -> None:
    late = "terminal._SAME_WISH_S = 0.0"
    assert signal_words(program(late), "SIGHUP", "SIGHUP", "SIGQUIT", "SIGINT") == [
        "SIGHUP",
        "SIGINT",
    ]


def test_nohup_stays_deaf_to_a_closed_terminal() -> None:
    nohup = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    assert signal_words(program(nohup), "SIGHUP", "SIGTERM") == ["SIGTERM"]


WRITER = """
import sys
from ssp_core import console
from ssp_core.host.terminal import lost_output, survive_lost_output
survive_lost_output()
sys.stdin.readline()
for _ in range(3):
    print("x" * 100_000)
    console.note("a note")
    console.out.print("a result")
sys.exit(2 if lost_output() else 0)
"""


def test_a_pipe_that_nobody_reads_raises_nothing() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    for stream in (process.stdout, process.stderr):
        assert stream is not None
        stream.close()
    process.communicate(b"\n", timeout=600)
    assert process.returncode == 0


def test_libraries_print_to_the_standard_error() -> None:
    """DDS prints its errors to the standard output, which programs read."""
    program = """
import os
from ssp_core.host import terminal
terminal.survive_lost_output()
terminal.keep_output_to_ourselves()
os.write(1, b"an error of a library\\n")
print("a result")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert done.stdout == b"a result\n"
    assert done.stderr == b"an error of a library\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_results_that_a_full_disk_did_not_take_are_an_error() -> None:
    """A command says so, whatever it would have ended with; it doesn't break off."""
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "ssp_core.cli", "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr == "error: standard output: No space left on device\n"


SUSPENDED = """
import sys
from ssp_core.host.terminal import on_suspension
goes_on = iter([False, True])
with on_suspension(lambda: next(goes_on)):
    print("up", flush=True)
    for _ in sys.stdin:
        print("after", flush=True)
"""


def test_ctrl_z_stops_a_process_unless_it_takes_it() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SUSPENDED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    process.send_signal(signal.SIGTSTP)
    until(lambda: _state_of(process.pid) == "T", "the process to stand still")
    process.send_signal(signal.SIGCONT)
    process.send_signal(signal.SIGTSTP)
    process.stdin.write("\n")
    process.stdin.flush()
    assert process.stdout.readline() == "after\n"
    process.stdin.close()
    assert process.wait(DEADLINE_S) == 0
    process.stdout.close()


def _state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_lines_are_written_in_their_order_and_nothing_waits_for_a_stopped_terminal() -> None:
    goes_on, written = threading.Event(), list[str]()

    def write(line: str) -> None:
        assert goes_on.wait(DEADLINE_S)
        if line == "lost":
            raise OSError(errno.EIO, "the terminal is closed")
        written.append(line)

    lines = LineWriter(write)
    assert lines.mark()()
    for line in ("a", "lost", "b"):
        lines(line)
    is_read = lines.mark()
    assert (written, is_read()) == ([], False)
    goes_on.set()
    until(is_read, "the lines to be written")
    lines("c")
    lines.close()
    assert written == ["a", "b", "c"]
