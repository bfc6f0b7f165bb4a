"""Line by line talk with a person, on a terminal or through a pipe."""

from __future__ import annotations

import sys
from typing import Protocol

import click

from ssp_core import console


class Terminal(Protocol):
    """Where questions go and answers come from; tests have their own."""

    def say(self, text: str) -> None:
        """Shows a line, or several."""

    def ask(self, prompt: str) -> str | None:
        """The next line, stripped; None when there are no more."""


class Stdio:
    """Standard input and output."""

    def say(self, text: str) -> None:
        console.out.print(text, markup=False)

    def ask(self, prompt: str) -> str | None:
        click.echo(console.visible(prompt), nl=False)
        line = sys.stdin.readline()
        if not sys.stdin.isatty():
            click.echo(
                console.visible(line.rstrip("\n"))
            )  # so that a log of a piped review reads like a talk
        return line.strip() if line else None


def ask_reason(terminal: Terminal, prompt: str = "  reason> ") -> str | None:
    """A reason of at least one word; None when the person gives none twice, or input ends."""
    for _ in range(2):
        text = terminal.ask(prompt)
        if text is None:
            return None
        if text:
            return text
        terminal.say("  a reason is needed; it goes into the log")
    return None
