"""The tests that ``ssp test`` runs, and the order in which its workers take them."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.compiled import TABLE
from ssp_eval import checkout
from ssp_eval.checkout import _checks
from tests.support.order import ROOT, spread

# Tests of each file, and their marker.
FILES = {
    "ssp_msgs/test/test_a.py": (40, None),
    "ssp_msgs/test/test_node.py": (3, "ros"),
    "ssp_eval/test/test_b.py": (30, None),
    "ssp_eval/test/test_c.py": (1, None),
    "ssp_eval/test/test_d.py": (25, None),
    "tests/system/test_page.py": (2, "system"),
    "tests/system/live/test_live.py": (4, "system"),
    "tests/test_e.py": (10, None),
}


def fake_item(name: str, marker: str | None) -> Any:
    return SimpleNamespace(path=ROOT / name, get_closest_marker=lambda asked: asked == marker)


def test_files_that_wait_lie_among_files_that_work_and_the_longest_come_first() -> None:
    items = [fake_item(name, marker) for name, (n, marker) in FILES.items() for _ in range(n)]
    ordered = spread(items)
    assert sorted(map(id, ordered)) == sorted(map(id, items))
    files = [path.relative_to(ROOT).as_posix() for path, _ in groupby(i.path for i in ordered)]
    assert sorted(files) == sorted(FILES), "a file's tests stay together"
    waiting = [name for name in files if FILES[name][1]]
    assert waiting == [
        "tests/system/live/test_live.py",
        "tests/system/test_page.py",
        "ssp_msgs/test/test_node.py",
    ]
    assert files[0] == waiting[0]
    assert [files.index(name) for name in waiting] == [0, 2, 5]
    assert FILES[files[-1]][1] is None
    assert spread(items[:40]) == items[:40], "without any that wait the order is kept"


def test_live_sessions_begin_apart_from_one_another() -> None:
    names = [f"tests/system/live/test_{n}.py" for n in range(3)]
    names += [f"tests/system/test_{n}.py" for n in range(20)]
    names += [f"ssp_eval/test/test_{n}.py" for n in range(80)]
    ordered = spread([fake_item(name, None if "ssp_eval" in name else "system") for name in names])
    assert len(set(map(id, ordered))) == len(names)
    waiting = [
        item.path.relative_to(ROOT).as_posix()
        for item in ordered
        if item.path.parent.name != "test"
    ]
    live = [place for place, name in enumerate(waiting) if "/live/" in name]
    assert live == [0, 6, 12]
    few = spread([fake_item(name, "system") for name in names[:5]])
    assert ["/live/" in str(item.path) for item in few] == [True, True, True, False, False]


def test_a_site_is_made_where_it_deletes_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(checkout, "DOCS_TOOLS", [sys.executable, "-c", ""])
    monkeypatch.setattr(checkout, "MKDOCS", [sys.executable, "-c", ""])
    (tmp_path / "mine.txt").write_text("mine")
    for out, words in (
        (tmp_path, "holds something else than a site, which would be deleted; name a new folder"),
        (tmp_path / "mine.txt", "is no folder; name another folder"),
    ):
        assert main(["docs", "--out", str(out)]) == 1
        assert words in " ".join(capfd.readouterr().err.split())
    assert (tmp_path / "mine.txt").read_text() == "mine"
    site = tmp_path / "site"
    assert main(["docs", "--out", str(site)]) == 0
    (site / "search").mkdir()
    (site / "search" / "search_index.json").write_text("{}")
    assert main(["docs", "--out", str(site)]) == 0, "a site is replaced"


def test_one_more_than_there_are_processors_runs_all_of_them() -> None:
    (*_, (name, command)) = _checks((), False, False)
    assert name == "tests"
    assert command[-2:] == ["-n", str((os.cpu_count() or 1) + 2)]
    assert "-m" not in command[3:]
    (*_, (_, quick)) = _checks((), True, False)
    assert quick[quick.index("-m", 3) + 1] == "not system and not programs"


# Asks for the end of its own process group's leader, as `ssp build-core` does, while it compiles.
INTERRUPTED = """
import os, pathlib, signal, subprocess, sys
sys.path.insert(0, "bootstrap")
import compile_core
compile_core.FOLDER = pathlib.Path(sys.argv[1])

def compile_to(folder):
    (folder / "half.so").touch()
    print(folder.name, flush=True)
    subprocess.run(["sleep", "600"], check=True)

compile_core.compile_to = compile_to
sys.exit(compile_core.main())
"""


@pytest.mark.programs
def test_an_interrupt_ends_it_without_a_trace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command of `ssp build-core`, with a compiler that doesn't end by itself."""
    place = tmp_path / "ssp-compiled"
    place.mkdir()
    (place / TABLE).touch()
    command = [sys.executable, "-c", INTERRUPTED, str(place)]
    monkeypatch.setattr(checkout, "COMPILE", command)
    waited = []

    class Process(subprocess.Popen[str]):
        """Ends the wait by Ctrl-C once the compiler runs."""

        def wait(self, timeout: float | None = None) -> int:
            if not waited:
                assert self.stdout is not None
                waited.append(self.stdout.readline())
                raise KeyboardInterrupt
            return super().wait(timeout)

    def start(*given: Any, **named: Any) -> Process:
        return Process(*given, **named, stdout=-1, stderr=subprocess.STDOUT, text=True)

    monkeypatch.setattr(subprocess, "Popen", start)
    ended = []
    monkeypatch.setattr(Process, "__exit__", lambda self, *_: ended.append(self))
    with pytest.raises(KeyboardInterrupt):
        checkout._run(command, ROOT, os.environ)
    (process,) = ended
    assert process.returncode == 130
    assert process.stdout.read() == ""
    process.stdout.close()
    assert waited[0].startswith("ssp-compiled.")
    assert sorted(os.listdir(place.parent)) == ["ssp-compiled", "ssp-compiled.lock"]
    assert (place / TABLE).is_file()
