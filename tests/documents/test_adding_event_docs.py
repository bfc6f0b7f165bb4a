"""docs/adding-an-event.md builds an event: its blocks, in a copy of the sources, run a session."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "adding-an-event.md").read_text()
PACKAGES = ("ssp_scenario_manager", "ssp_ot_controller", "ssp_eval")
# Each block is saved under the name that the sentence before it ends with, or gives.
SAVED = re.compile(r"[Ss]ave as `([^`]+)`[^\n]*\n\n```(?:python|diff)\n(.*?)```", re.S)
CONSOLE = re.findall(r"```console\n(.*?)```", TEXT, re.S)


def command_of(words: str) -> list[str]:
    """Return a command of the page with this interpreter."""
    program, *rest = shlex.split(words)
    if program == "git":
        return [program, *rest]
    return [sys.executable, *(("-m", "ssp_core.cli") if program == "ssp" else ()), *rest]


def shown_in(block: str) -> list[tuple[str, list[str]]]:
    """Return the commands of a block, with the pieces of their output between ellipses."""
    made = []
    for part in re.split(r"^\$ ", block.replace("\\\n", ""), flags=re.M)[1:]:
        words, _, output = part.partition("\n")
        pieces = (piece.strip() for piece in re.split(r"…|\n", output))
        made.append((words, [piece for piece in pieces if piece]))
    return made


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Gives a copy of the sources that the page changes, with its files."""
    root = tmp_path_factory.mktemp("checkout")
    for name in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name / name, root / name / name, ignore=ignored)
    for path, content in SAVED.findall(TEXT):
        (root / path).write_text(content)
    return root


def done(checkout: Path, words: str) -> str:
    """Run a command of the page in the copy, and return what it prints."""
    path = os.pathsep.join(str(checkout / name) for name in PACKAGES)
    # A repository around the folder would make `git apply` skip what lies outside of it.
    env = {**os.environ, "PYTHONPATH": path, "GIT_CEILING_DIRECTORIES": str(checkout.parent)}
    ran = subprocess.run(
        command_of(words),
        cwd=checkout,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, f"{words}\n{ran.stdout}"
    return ran.stdout


def test_the_blocks_of_the_page_make_an_event_that_runs(checkout: Path) -> None:
    for words in ("git apply drift_in.patch", "python make_event.py"):
        assert f"`{words}`" in TEXT
        done(checkout, words)
    shown = shown_in(CONSOLE[0])
    assert [words.split()[1] for words, _ in shown] == ["spec", "compile", "run"]
    for words, pieces in shown:
        printed, at = done(checkout, words), 0
        for piece in pieces:
            assert piece in printed[at:], f"{words}: {piece!r} isn't next in\n{printed}"
            at = printed.index(piece, at) + len(piece)
