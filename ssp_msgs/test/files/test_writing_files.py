"""Files and folders are written whole or not at all, by one writer."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from ssp_core.errors import HostError, InputError
from ssp_core.files.folders import (
    TAKEN_FILE,
    new_folder,
    put_in_place,
    scratch_beside,
    taken_folder,
)
from ssp_core.files.writing import write_bytes, write_json


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_write_makes_folders_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "file"
    write_bytes(path, b"one")
    write_bytes(path, b"two")
    assert path.read_bytes() == b"two"
    assert names(path.parent) == ["file"]
    assert path.stat().st_mode & 0o777 == 0o644


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    write_bytes(path, b"old")

    def no_replace(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("ssp_core.files.writing.os.replace", no_replace)
    with pytest.raises(HostError, match="disk full"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["file"]


def test_a_place_that_takes_no_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(InputError, match="is a folder; name a file"):
        write_bytes(tmp_path, b"new")
    with pytest.raises(InputError, match="file is no folder"):
        write_bytes(tmp_path / "file" / "below", b"new")
    assert (tmp_path / "file").read_bytes() == b"mine"
    assert names(tmp_path) == ["file"]


def test_json_that_cannot_be_written_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_json(path, {"b": 1, "a": 2})
    assert path.read_text() == '{\n "a": 2,\n "b": 1\n}\n'
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"a": float("nan")})
    assert json.loads(path.read_text()) == {"a": 2, "b": 1}
    assert os.listdir(tmp_path) == ["x.json"]


HOLDER = """
import sys
from pathlib import Path
from ssp_core.errors import InputError
from ssp_core.files.folders import taken_folder
try:
    with taken_folder(Path(sys.argv[1]), empty=sys.argv[2] == "empty"):
        print("has it", flush=True)
        sys.stdin.read()
except InputError as error:
    print(error, flush=True)
"""


@contextmanager
def another_command(folder: Path, *, empty: bool = True) -> Iterator[subprocess.Popen[str]]:
    """A command that takes the folder until its input ends, and says whether it has it."""
    command = [sys.executable, "-c", HOLDER, str(folder), "empty" if empty else "any"]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
    with process:
        yield process
        process.kill()


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_a_folder_has_one_writer(tmp_path: Path) -> None:
    """Two runs into one new folder destroyed each other's recording."""
    out = tmp_path / "out"
    with another_command(out) as first:
        assert first_line(first) == "has it"
        with another_command(out) as second:
            assert "another command is writing into it" in first_line(second)
        with (
            pytest.raises(InputError, match="another command is writing into"),
            taken_folder(out),
        ):
            pass
        assert names(out) == [TAKEN_FILE]
        assert first.stdin is not None
        first.stdin.close()
        first.wait(60.0)
    assert not out.exists()
    with taken_folder(out, empty=True) as folder:
        (folder / "result").write_text("ours")
    with pytest.raises(InputError, match="is not empty"), taken_folder(out, empty=True):
        pass
    with taken_folder(out):
        assert names(out) == [TAKEN_FILE, "result"]


def test_of_many_that_come_at_once_one_gets_the_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with ExitStack() as stack:
        many = [stack.enter_context(another_command(out)) for _ in range(6)]
        assert sorted(first_line(one) == "has it" for one in many) == [False] * 5 + [True]


def test_a_folder_whose_writer_was_killed_is_taken_over(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with another_command(out) as first:
        assert first_line(first) == "has it"
        first.kill()
        first.wait(60.0)
        assert names(out) == [TAKEN_FILE]
        with another_command(out) as second:
            assert first_line(second) == "has it"


def folder_with(folder: Path, text: str) -> Path:
    folder.mkdir()
    (folder / "file").write_text(text)
    return folder


def test_a_finished_folder_takes_the_place_of_an_earlier_one(tmp_path: Path) -> None:
    target = tmp_path / "target"
    for text in ("one", "two"):
        put_in_place(folder_with(tmp_path / "made", text), target)
        assert (target / "file").read_text() == text
        assert names(tmp_path) == ["target"]


def test_a_folder_whose_place_cannot_be_taken_is_one_message_and_the_earlier_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder here, as a mount, can't be renamed."""
    here = folder_with(tmp_path / "here", "mine")
    made = folder_with(tmp_path / "made", "new")
    monkeypatch.chdir(here)
    with pytest.raises(HostError, match=r"^\.: can't be written: .*; name a new folder within it$"):
        put_in_place(made, Path())
    assert (here / "file").read_text() == "mine"
    assert names(tmp_path) == ["here", "made"]


def test_an_interruption_between_two_names_leaves_the_earlier_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = folder_with(tmp_path / "target", "mine")
    made = folder_with(tmp_path / "made", "new")
    rename = Path.rename

    def interrupted(path: Path, to: Path) -> Path:
        if path == made:
            raise KeyboardInterrupt
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        put_in_place(made, target)
    assert (target / "file").read_text() == "mine"
    assert names(tmp_path) == ["made", "target"]


def test_a_disk_that_takes_no_file_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("ssp_core.files.writing.os.replace", full)
    with pytest.raises(HostError, match="No space left on device; make room and try again"):
        write_bytes(tmp_path / "file", b"new")
    monkeypatch.setattr("ssp_core.files.folders.tempfile.mkdtemp", full)
    with pytest.raises(InputError, match=r"can't be made: .*; make room and try again"):
        scratch_beside(tmp_path / "target")
    with pytest.raises(InputError, match=r"File name too long; give a shorter name$"):
        scratch_beside(tmp_path / ("a" * 300))
    assert names(tmp_path) == []


def test_a_new_folder_that_another_made_meanwhile_is_left_alone(tmp_path: Path) -> None:
    making = new_folder(tmp_path / "new")
    making.__enter__().mkdir()
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "theirs").write_text("theirs")
    with pytest.raises(InputError, match="exists already"):
        making.__exit__(None, None, None)
    assert names(tmp_path / "new") == ["theirs"]
    assert names(tmp_path) == ["new"]
