"""A program of ours looks for cycles seldom while it starts, and as usual from then on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ssp_core.cycles import STARTING

_TOLD = "import gc\nprint(*gc.get_threshold(), gc.get_freeze_count() > 0)\n"


def _output_words(folder: Path, *command: str) -> list[str]:
    """Run a program in a folder, and return the words that it prints."""
    done = subprocess.run(
        [sys.executable, *command], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.fixture
def usual(tmp_path: Path) -> list[str]:
    return _output_words(tmp_path, "-c", _TOLD)[:3]


def test_a_program_searches_seldom_until_it_says_that_it_has_started(
    tmp_path: Path, usual: list[str]
) -> None:
    program = "from ssp_core.cycles import search_as_usual\n"
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / "__init__.py").write_text("import ssp_core\n")
    (tmp_path / "ours" / "starts.py").write_text(_TOLD)
    (tmp_path / "ours" / "runs.py").write_text(f"{program}search_as_usual()\n{_TOLD}")
    assert _output_words(tmp_path, "-m", "ours.starts") == [str(STARTING), *usual[1:], "False"]
    assert _output_words(tmp_path, "-m", "ours.runs") == [*usual, "True"]


@pytest.mark.parametrize("command", [("-c", f"import ssp_core\n{_TOLD}"), ("-m", "others")])
def test_a_program_of_others_that_imports_us_searches_as_before(
    tmp_path: Path, usual: list[str], command: tuple[str, str]
) -> None:
    (tmp_path / "others.py").write_text(f"import ssp_core\n{_TOLD}")
    assert _output_words(tmp_path, *command) == [*usual, "False"]
