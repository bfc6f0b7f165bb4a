"""Nothing from a file reaches the terminal as a control sequence."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.progress import Progress

from ssp_core import console
from ssp_core.cli import main

HOSTILE = "a\x1b[2Jb\x1b]0;title\x07c\x9b31m\rd\u202ee\x7f"


def test_controls_are_shown_and_the_rest_is_left_alone() -> None:
    shown = r"a\x1b[2Jb\x1b]0;title\x07c\x9b31m\rd\u202ee\x7f"
    assert console.visible(HOSTILE) == shown
    assert console.visible("tab\tline\nü – ✓ 車") == "tab\tline\nü – ✓ 車"


def test_what_is_printed_holds_no_controls(capsys: pytest.CaptureFixture[str]) -> None:
    console.report_error(HOSTILE)
    console.note(HOSTILE)
    console.out.print(HOSTILE, markup=False)
    told = capsys.readouterr()
    for text, times in ((told.err, 2), (told.out, 1)):
        assert text.count(r"a\x1b[2Jb\x1b]0;title\x07c") == times
        assert console.visible(text) == text


def test_a_progress_bar_takes_no_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    class Screen(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen: Any = Screen()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setattr(
        console, "err", type(console.err)(file=screen, force_terminal=True, width=200)
    )
    bar: Progress
    with console.progress("start", 3) as bar:
        bar.update(bar.task_ids[0], advance=1, description=f"[bold]road {HOSTILE}")
        bar.refresh()
    assert r"[bold]road a\x1b[2Jb" in screen.getvalue()
    assert "\x1b[2J" not in screen.getvalue()
    assert "\x1b]0" not in screen.getvalue()


def test_a_bad_argument_is_shown_harmlessly(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", "none\x1b[2J"]) == 1
    assert "\x1b[2J" not in capsys.readouterr().err
