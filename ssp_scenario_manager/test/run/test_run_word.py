"""A person's word at the terminal: only `start`, typed after the prompt, starts anything."""

from __future__ import annotations

import os
import pty
import select
import termios
import time
from collections.abc import Iterator

import pytest

from ssp_core.clock import seconds_to_ns
from ssp_scenario_manager.run.over_dds.word import HOLDS_S, PASTE_S, TypedWords, Word, word_of
from tests.support.processes.waiting import DEADLINE_S

S = 1_000_000_000
LATER = int(PASTE_S * S) + 1


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (b"", None),
        (b"start", None),
        (b"start\n", Word.START),
        (b"  start \r\n", Word.START),
        (b"\n", Word.OTHER),
        (b"go\n", Word.OTHER),
        (b"START\n", Word.OTHER),
        (b"start now\n", Word.OTHER),
        (b"start\nstart\n", Word.OTHER),
        (b"\nstart\n", Word.OTHER),
        (b"start\nx", Word.OTHER),
        (b"abort\n", Word.ABORT),
        (b"ABORT\n", Word.ABORT),
        (b" Abort\r\n", Word.ABORT),
        (b"do not abort\n", Word.OTHER),
        (b"start\nabort\n", Word.ABORT),
        (b"\xff\xfe\n", Word.OTHER),
    ],
)
def test_one_word_starts(text: bytes, word: Word | None) -> None:
    assert word_of(text) is word


class Hand:
    """A person at a stream, and the words that are heard from it. Time is counted by hand."""

    def __init__(self, read: int, write: int) -> None:
        self.words, self.fd, self._write, self.now_ns = TypedWords(read), read, write, 0

    def types(self, text: str) -> None:
        os.write(self._write, text.encode())

    def arrives_at_terminal(self, text: str) -> None:
        """Waits until a terminal has echoed all of it: its line discipline has it then."""
        echo = b""
        while text != "\x04" and not echo.endswith(text.replace("\n", "\r\n").encode()):
            echo += os.read(self._write, 1024)

    def hears(self) -> Word | None:
        """Return the word that is heard at once, or else after the time in which a paste ends."""
        at_once = self.words.poll(self.now_ns)
        self.now_ns += LATER
        return at_once or self.words.poll(self.now_ns)

    def awaits(self) -> Word:
        """The next word; a terminal passes on in its own time."""
        deadline = time.monotonic() + DEADLINE_S
        while (word := self.hears()) is None:
            assert time.monotonic() < deadline, "no word was heard"
            select.select([self.fd], [], [], 0.01)
        return word

    def closes(self) -> None:
        os.close(self._write)
        self._write = -1

    def end(self) -> None:
        if self._write >= 0:
            self.closes()


@pytest.fixture
def pipe() -> Iterator[Hand]:
    read, write = os.pipe()
    hand = Hand(read, write)
    yield hand
    hand.end()
    os.close(read)


@pytest.mark.parametrize("early", ["\n", "start\n", "start\nstart\n"])
def test_what_a_pipe_held_before_the_prompt_does_not_count(pipe: Hand, early: str) -> None:
    pipe.types(early)
    pipe.words.ask(pipe.now_ns)
    assert pipe.hears() is None
    pipe.types("start\n")
    assert pipe.hears() is Word.START


@pytest.mark.parametrize("looks", [False, True])
def test_a_word_that_lies_there_for_longer_than_it_holds_starts_nothing(
    pipe: Hand, looks: bool
) -> None:
    """The process stood still after its prompt; what it finds then may be of any age."""
    pipe.words.ask(pipe.now_ns)
    if looks:
        assert pipe.hears() is None
    pipe.types("start\n")
    pipe.now_ns += seconds_to_ns(HOLDS_S) + 1
    assert pipe.hears() is Word.OTHER
    pipe.types("abort\n")
    pipe.now_ns += seconds_to_ns(3600.0)
    assert pipe.hears() is Word.ABORT
    pipe.words.ask(pipe.now_ns)
    assert pipe.hears() is None
    looked_ns = pipe.now_ns
    pipe.types("start\n")
    pipe.now_ns += seconds_to_ns(4.0)
    assert pipe.hears() is Word.START
    assert pipe.words.typed_after_ns == looked_ns


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize(("text", "counts"), [("abort", True), ("start", False)])
def test_of_a_pipe_that_ends_within_a_line_abort_counts_alone(
    pipe: Hand, text: str, counts: bool, asked: bool
) -> None:
    if asked:
        pipe.words.ask(pipe.now_ns)
    pipe.types(text)
    pipe.closes()
    assert pipe.hears() is (Word.ABORT if counts else Word.END_OF_INPUT if asked else None)


@pytest.mark.parametrize("text", ["stop\n", "abort!\n", "start\n", "\n", "stop\nnow\n", "stop\r"])
def test_a_line_that_does_not_count_without_a_question_is_told_once(pipe: Hand, text: str) -> None:
    pipe.types(text)
    assert pipe.hears() is Word.OTHER
    assert pipe.hears() is None
    pipe.types("abo")
    assert pipe.hears() is None
    pipe.types("rt\n")
    assert pipe.hears() is Word.ABORT


@pytest.mark.timeout(60)
def test_an_input_that_never_runs_dry_keeps_nobody() -> None:
    fd = os.open("/dev/zero", os.O_RDONLY)
    try:
        assert TypedWords(fd).poll(0) is Word.OTHER  # as any text that is too long
    finally:
        os.close(fd)


@pytest.mark.parametrize("early", ["do not ", "sta", " "])
def test_a_line_of_a_pipe_that_began_before_the_prompt_does_not_count(
    pipe: Hand, early: str
) -> None:
    pipe.types(early)
    pipe.words.ask(pipe.now_ns)
    pipe.types("start\n")
    assert pipe.hears() is None
    pipe.types("start\n")
    assert pipe.hears() is Word.START


def test_an_abort_that_began_before_the_prompt_counts(pipe: Hand) -> None:
    pipe.types("abo")
    pipe.words.ask(pipe.now_ns)
    pipe.types("rt\n")
    assert pipe.hears() is Word.ABORT


@pytest.mark.parametrize("asks", [True, False])
def test_an_abort_counts_whatever_follows_it(pipe: Hand, asks: bool) -> None:
    if asks:
        pipe.words.ask(pipe.now_ns)
    pipe.types("abort\n" + "x\n" * 2100)
    assert pipe.hears() is Word.ABORT


@pytest.mark.parametrize("text", ["foo\n" + " " * 4090 + "start\n", "x" * 9000 + "\nstart\n"])
def test_a_long_text_is_one_wrong_answer(pipe: Hand, text: str) -> None:
    pipe.words.ask(pipe.now_ns)
    pipe.types(text)
    assert pipe.hears() is Word.OTHER


def test_a_paste_is_one_wrong_answer(pipe: Hand) -> None:
    pipe.words.ask(pipe.now_ns)
    pipe.types("start\nls -l\n")
    assert pipe.hears() is Word.OTHER
    assert pipe.hears() is None
    pipe.words.ask(pipe.now_ns)
    # Also when it comes in pieces.
    pipe.types("start\n")
    assert pipe.words.poll(pipe.now_ns) is None
    pipe.now_ns += int(0.9 * PASTE_S * S)
    pipe.types("start\n")
    assert pipe.words.poll(pipe.now_ns) is None
    assert pipe.hears() is Word.OTHER


def test_abort_and_the_end_of_input_give_up(pipe: Hand) -> None:
    pipe.words.ask(pipe.now_ns)
    pipe.types("abort\n")
    assert pipe.hears() is Word.ABORT
    pipe.words.ask(pipe.now_ns)
    pipe.closes()
    assert pipe.hears() is Word.END_OF_INPUT


def test_a_pipe_that_ended_before_the_prompt_starts_nothing(pipe: Hand) -> None:
    pipe.types("start\n")
    pipe.closes()
    assert pipe.hears() is Word.OTHER
    pipe.words.ask(pipe.now_ns)
    assert pipe.hears() is Word.END_OF_INPUT


def test_a_word_that_ends_the_input_counts(pipe: Hand) -> None:
    pipe.words.ask(pipe.now_ns)
    pipe.types("start\n")
    pipe.closes()
    assert pipe.hears() is Word.START


def test_abort_counts_without_a_question_and_before_it(pipe: Hand) -> None:
    pipe.types("start\n")
    assert pipe.hears() is Word.OTHER
    pipe.types("abort\n")
    assert pipe.hears() is Word.ABORT
    pipe.types("abort\n")
    pipe.words.ask(pipe.now_ns)
    assert pipe.hears() is Word.ABORT


@pytest.fixture
def terminal() -> Iterator[Hand]:
    """A real terminal, with its line discipline; the hand holds its other end."""
    master, slave = pty.openpty()
    hand = Hand(slave, master)
    yield hand
    hand.end()
    os.close(slave)


@pytest.mark.parametrize("early", ["\n", "start\n", "start\nstart\n"])
def test_type_ahead_starts_nothing(terminal: Hand, early: str) -> None:
    """Enter, a second after the command was started, armed and started everything."""
    terminal.types(early)
    terminal.arrives_at_terminal(early)
    terminal.words.ask(terminal.now_ns)
    assert terminal.hears() is None
    terminal.types("start\n")
    assert terminal.awaits() is Word.START


def test_the_words_of_a_terminal(terminal: Hand) -> None:
    for text, word in [
        ("\n", Word.OTHER),
        ("yes\n", Word.OTHER),
        ("abort\n", Word.ABORT),
        ("start\nls\n", Word.OTHER),
        ("start\nls", Word.OTHER),
        ("\x04", Word.END_OF_INPUT),
    ]:
        terminal.words.ask(terminal.now_ns)
        terminal.types(text)
        terminal.arrives_at_terminal(text)
        assert terminal.awaits() is word, text


def test_a_terminal_keeps_its_settings(terminal: Hand) -> None:
    before = termios.tcgetattr(terminal.fd)
    terminal.words.ask(terminal.now_ns)
    terminal.types("start\n")
    assert terminal.awaits() is Word.START
    assert termios.tcgetattr(terminal.fd) == before


def test_a_terminal_that_is_closed_gives_up(terminal: Hand) -> None:
    terminal.words.ask(terminal.now_ns)
    terminal.closes()
    assert terminal.awaits() is Word.END_OF_INPUT


def test_ctrl_d_before_the_prompt_is_no_end(terminal: Hand) -> None:
    terminal.types("\x04")
    assert terminal.hears() is None
    terminal.words.ask(terminal.now_ns)
    terminal.types("start\n")
    assert terminal.awaits() is Word.START


def test_who_has_no_input_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    words = TypedWords()
    assert words.poll(0) is None
    words.ask(0)
    assert words.poll(0) is Word.END_OF_INPUT
