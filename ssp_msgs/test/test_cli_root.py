"""The command line as a whole: verbs, exit statuses, one message per error, a quick start."""

from __future__ import annotations

import errno
import gc
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import pytest

from ssp_core.cli import VERBS, cli, main
from ssp_core.errors import HostError, InputError, PeerError


@pytest.fixture
def verb(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], object]], None]:
    """Puts a function behind the verb ``probe``."""

    def install(function: Callable[[], object]) -> None:
        monkeypatch.setattr(
            sys.modules[__name__], "probe", click.command()(function), raising=False
        )
        monkeypatch.setitem(VERBS, "probe", (f"{__name__}:probe", "for this test"))

    return install


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("3", "3")])
def test_matrices_are_computed_by_one_thread_unless_the_user_says_otherwise(
    given: str | None, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    assert main(["--version"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == expected


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_has_a_command_with_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    assert "Usage: ssp " + name in capsys.readouterr().out


def options_of(command: click.Command, name: str) -> Iterator[tuple[str, click.Option]]:
    """Yield the options of a command and of those below it, each with its place."""
    context = click.Context(command)
    if isinstance(command, click.Group):
        for below in command.list_commands(context):
            found = command.get_command(context, below)
            assert found is not None
            yield from options_of(found, f"{name} {below}")
    for option in command.params:
        if isinstance(option, click.Option):
            yield f"{name} {option.opts[-1]}", option


def test_the_help_of_an_option_stands_alone_and_its_range_has_ends() -> None:
    """A preposition at its opening leaves out what is given."""
    opening = re.compile(r"(Of|For|To|In|On|At|From|Likewise)\b")
    wrong = [place for place, option in options_of(cli, "ssp") if opening.match(option.help or "")]
    wrong += [
        place
        for place, option in options_of(cli, "ssp")
        if isinstance(option.type, click.IntRange) and option.type.min is option.type.max is None
    ]
    assert wrong == []


@pytest.mark.parametrize("arguments", [["--help"], ["-h"]])
def test_help_lists_every_verb(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    out = capsys.readouterr().out
    for name, (_, text) in VERBS.items():
        assert f"  {name} " in out
        assert text.split()[0] in out


def test_wrong_usage_is_2(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["fly"], ["--fly"], ["run"], ["run", "cut_in", "--fly"]):
        assert main(arguments) == 2
        assert "Error" in capsys.readouterr().err


def test_a_verb_is_imported_without_looking_for_cycles_and_runs_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Imported objects stay; the search for cycles in them takes a tenth of the time."""
    (tmp_path / "verb_of_this_test.py").write_text(
        "import gc, click\ncollects = gc.isenabled()\n"
        "probe = click.command()(lambda: click.echo(f'{collects} {gc.isenabled()}'))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(VERBS, "probe", ("verb_of_this_test:probe", "for this test"))
    assert main(["probe"]) == 0
    assert capsys.readouterr().out == "False True\n"
    monkeypatch.setitem(VERBS, "probe", ("verb_that_is_missing:probe", "for this test"))
    with pytest.raises(ModuleNotFoundError):
        main(["probe"])
    assert gc.isenabled()


@pytest.mark.parametrize("name", [b"out\xfc", b"\xff.mp4", b"--who=J\xfcrgen"])
def test_an_argument_that_is_no_utf_8_is_refused_before_anything_is_done(
    name: bytes, verb: Callable[[Callable[[], object]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []
    verb(lambda: done.append("ran"))
    assert main(["probe", os.fsdecode(name)]) == 1
    told = capsys.readouterr().err
    assert done == []
    assert f"the argument {name.decode('utf-8', 'backslashreplace')} is no UTF-8" in told
    assert "rename the file or folder" in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        (["--out", ""], "the argument after --out"),
        (["--out="], "--out="),
        (["", "cut_in"], "the argument after probe"),
    ],
)
def test_an_empty_argument_is_wrong_usage_before_anything_is_done(
    arguments: list[str],
    where: str,
    verb: Callable[[Callable[[], object]], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The folder here is what it would be as a path, and an unset variable would write into it."""
    done: list[str] = []
    verb(lambda: done.append("ran"))
    assert main(["probe", *arguments]) == 2
    assert f"Error: {where} is empty; give a value or leave it out" in capsys.readouterr().err
    assert done == []
    assert main(["test", "-k", "", "--help"]) == 0  # what goes on to pytest is pytest's


def test_a_folder_that_is_no_utf_8_is_no_place_to_work_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, status in ((os.fsdecode(b"m\xfcll"), 1), ("müll", 0)):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert main(["--help"]) == status
    assert "the folder here" in capsys.readouterr().err


def test_a_name_that_is_too_long_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a" * 300, "ä" * 150):
        assert main(["run", "cut_in", "--in-process", "--out", str(tmp_path / name)]) == 1
        told = capsys.readouterr().err
        assert "File name too long; give a shorter name" in told
        assert "Traceback" not in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [InputError, PeerError, HostError])
def test_an_error_of_ours_is_1_and_one_message(
    verb: Callable[[Callable[[], object]], None],
    error: type[Exception],
    capsys: pytest.CaptureFixture[str],
) -> None:
    def function() -> None:
        raise error("a [red]problem[/] in x.yaml[3]")

    verb(function)
    assert main(["probe"]) == 1
    captured = capsys.readouterr()
    assert captured.err == "error: a [red]problem[/] in x.yaml[3]\n"
    assert captured.out == ""


@pytest.mark.parametrize(("returned", "status"), [(None, 0), (0, 0), (1, 1), ("text", 0)])
def test_what_a_verb_returns_is_the_status(
    verb: Callable[[Callable[[], object]], None], returned: object, status: int
) -> None:
    verb(lambda: returned)
    assert main(["probe"]) == status


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption(
    verb: Callable[[Callable[[], object]], None],
    number: signal.Signals,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def function() -> None:
        signal.raise_signal(number)

    verb(function)
    assert main(["probe"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_a_full_disk_is_one_message(
    verb: Callable[[Callable[[], object]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def function() -> None:
        with open("/dev/full", "w") as file:
            file.write("a result")

    verb(function)
    assert main(["probe"]) == 1
    assert capsys.readouterr().err == (
        "error: the disk: No space left on device; make room and try again\n"
    )


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.EDQUOT])
def test_what_the_system_forbids_is_one_message_with_file_and_remedy(
    number: int,
    verb: Callable[[Callable[[], object]], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    def function() -> None:
        raise OSError(number, os.strerror(number), "out/task")

    verb(function)
    assert main(["probe"]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"error: out/task: {os.strerror(number)}; ")
    assert told.count("\n") == 1


def test_a_bug_is_a_traceback(verb: Callable[[Callable[[], object]], None]) -> None:
    def function() -> None:
        raise RuntimeError("a bug")

    verb(function)
    with pytest.raises(RuntimeError, match="a bug"):
        main(["probe"])


def test_help_loads_nothing_heavy() -> None:
    """A module that takes long to import is loaded only by the verb that needs it."""
    code = (
        "import sys; from ssp_core.cli import main; main(['--help']); "
        "heavy = {'numpy', 'cv2', 'rclpy', 'libsumo', 'numba', 'pydantic', 'scipy', 'matplotlib'}; "
        "print('LOADED', sorted(heavy & set(sys.modules)))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True
    )
    assert result.stdout.splitlines()[-1] == "LOADED []"


def test_a_closed_pipe_is_no_traceback() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "ssp_core.cli", "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert "Traceback" not in process.stderr.read()
    process.wait(timeout=600)
    process.stderr.close()


@pytest.mark.parametrize(("arguments", "status"), [(["--version"], 0), (["fly"], 2)])
def test_a_command_ends_without_the_end_of_its_libraries(arguments: list[str], status: int) -> None:
    """Static objects of the middleware may hang at the exit; a handler of libc does here."""
    code = (
        "import ctypes, sys; from ssp_core.cli import entry; libc = ctypes.CDLL(None); "
        "libc.__cxa_atexit(libc.pause, None, None); "
        f"sys.argv[1:] = {arguments!r}; entry()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == status, done.stderr
    assert ("version" in done.stdout) is (status == 0)
    assert "Traceback" not in done.stderr
