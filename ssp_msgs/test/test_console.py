"""Nothing from a file reaches the terminal as a control sequence."""

from __future__ import annotations

import io
import json
from pathlib import Path
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


def test_a_name_between_colons_is_no_emoji(capsys: pytest.CaptureFixture[str]) -> None:
    console.report_error("host:b:c")
    assert capsys.readouterr().err == "error: host:b:c\n"


def test_what_is_printed_holds_no_controls(capsys: pytest.CaptureFixture[str]) -> None:
    console.report_error(HOSTILE)
    console.note(HOSTILE)
    console.out.print(HOSTILE, markup=False)
    told = capsys.readouterr()
    for text, times in ((told.err, 2), (told.out, 1)):
        assert text.count(r"a\x1b[2Jb\x1b]0;title\x07c") == times
        assert console.visible(text) == text


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def terminal(monkeypatch: pytest.MonkeyPatch) -> Screen:
    """A terminal as standard error, for the rest of a test."""
    made: Any = Screen()
    monkeypatch.setattr("sys.stderr", made)
    monkeypatch.setattr(
        console, "err", type(console.err)(file=made, force_terminal=True, width=200)
    )
    return made


def test_what_is_tracked_shows_its_total_and_results_stay_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    screen = terminal(monkeypatch)
    for item in console.tracked(["a", "b", "c"], "texts", 3):
        print(item)
    assert capsys.readouterr().out == "a\nb\nc\n"
    assert "texts" in screen.getvalue()
    assert "3/3" in screen.getvalue()
    assert "\nb" not in screen.getvalue()


def test_a_long_command_shows_its_total(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    screen = terminal(monkeypatch)
    file = tmp_path / "texts.jsonl"
    file.write_text("".join(json.dumps({"id": k, "text": "I brake."}) + "\n" for k in range(3)))
    assert main(["extract", str(file)]) == 0
    assert "3/3" in screen.getvalue()
    assert [json.loads(line)["id"] for line in capsys.readouterr().out.splitlines()] == [0, 1, 2]


def test_a_progress_bar_takes_no_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = terminal(monkeypatch)
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
