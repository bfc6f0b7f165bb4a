"""The dialogue of a review at a terminal: a question, a decision of one word, and its reason."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file

# The answer that ends a review; so does the end of input.
QUIT = "quit"


class Terminal(Protocol):
    """The source of answers and the place of questions; tests have their own."""

    def say(self, text: str) -> None:
        """Show a line, or several."""

    def ask(self, prompt: str) -> str | None:
        """Return the next line, stripped; None when there are no more."""


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
    """Return a reason of a word or more; None at the end of input or after two empty ones."""
    for _ in range(2):
        text = terminal.ask(prompt)
        if text is None:
            return None
        if text:
            return text
        terminal.say("  a reason is needed; it goes into the log")
    return None


def decide(
    terminal: Terminal, prompt: str, usage: str, acts: Mapping[str, Callable[[], bool]]
) -> str:
    """Ask until a question is settled.

    Args:
        terminal: asked.
        prompt: names the acts.
        usage: shown for any other answer.
        acts: by word, of which the first letter will do; each returns whether it settled the
            question.

    Returns:
        The word of the act, or QUIT.
    """
    word_of = {answer: word for word in (*acts, QUIT) for answer in (word, word[0])}
    while True:
        answer = terminal.ask(prompt)
        word = QUIT if answer is None else word_of.get(answer)
        if word is None:
            terminal.say(usage)
        elif word == QUIT or acts[word]():
            return word


class FileUnderReview:
    """A file that this review alone may change, as it was last read or written here."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.written()

    def written(self) -> None:
        """Take the file as it is now."""
        self.digest = sha256_file(self._path)

    def check(self) -> None:
        """Raise InputError if somebody else has changed it."""
        if sha256_file(self._path) != self.digest:
            raise InputError(
                "was changed by somebody else during the review",
                file=self._path,
                remedy="start the review again; what was decided before is kept",
            )
