r"""Regular expressions over topic names that take linear time, whatever the expression.

Names come from the network and expressions from people; Python's own ``re`` goes back and forth
and may need years for a short name. This one follows all ways at once (Thompson's construction)
and remembers each step it took, so that a name costs one look-up per character.

Understood: characters, ``.``, ``[a-z]``, ``[^a-z]``, ``\d \w \s \D \W \S``, an escaped
character, ``( )``, ``(?: )``, ``|``, ``*``, ``+``, ``?``, ``^`` and ``$``. As in ``re.search``, the
expression may stand anywhere in the name.
"""

from __future__ import annotations

import string
from dataclasses import dataclass

from ssp_core.errors import InputError

MOST_CHARACTERS = 1000
# Beyond that the remembered steps are forgotten: they are a cache.
_MOST_STATES = 2000
# Stand for the two ends of a name; no name holds them.
_START, _END = "\x02", "\x03"
_ENDS = frozenset((_START, _END))
_SPECIAL = "*+?|()[]{}\\^$."
_DIGITS = frozenset(string.digits)
_WORDS = _DIGITS | frozenset(string.ascii_letters) | {"_"}
_SPACES = frozenset(string.whitespace)
_CLASSES = {"d": _DIGITS, "w": _WORDS, "s": _SPACES}


@dataclass(frozen=True, slots=True)
class _Chars:
    """One character out of a set, or out of all others."""

    chars: frozenset[str]
    others: bool = False

    def takes(self, char: str) -> bool:
        if char in _ENDS:
            return not self.others and char in self.chars
        return (char in self.chars) is not self.others


@dataclass(frozen=True, slots=True)
class _Step:
    """One instruction: take a character and go on, or go on at each of several places."""

    chars: _Chars | None = None
    to: tuple[int, ...] = ()


class Pattern:
    """One expression, ready for use.

    Args:
        text: the expression.
        field: what it is called towards people, such as ``--include``.

    Raises:
        InputError: it is none, or uses what is not understood.
    """

    def __init__(self, text: str, field: str) -> None:
        self.text = text
        if len(text) > MOST_CHARACTERS:
            raise InputError(
                f"is longer than {MOST_CHARACTERS} characters", field=field, value=text
            )
        parser = _Parser(text, field)
        # Anywhere in the name: any characters, the ends among them, may come before.
        self._program = parser.program
        start = parser.parse()
        self._start = self._closure({start})
        self._initial = start
        self._accept = parser.accept
        self._steps: dict[tuple[frozenset[int], str], frozenset[int]] = {}

    def found_in(self, name: str) -> bool:
        """Whether the expression matches somewhere in the name."""
        if not _ENDS.isdisjoint(name):
            return False
        state = self._start
        accept = self._accept
        if accept in state:
            return True
        for char in f"{_START}{name}{_END}":
            known = self._steps.get((state, char))
            if known is None:
                known = self._step(state, char)
            state = known
            if accept in state:
                return True
        return False

    def _step(self, state: frozenset[int], char: str) -> frozenset[int]:
        reached = {self._initial}
        for at in state:
            step = self._program[at]
            if step.chars is not None and step.chars.takes(char):
                reached.update(step.to)
        if len(self._steps) >= _MOST_STATES:
            self._steps.clear()
        found = self._closure(reached)
        self._steps[(state, char)] = found
        return found

    def _closure(self, places: set[int]) -> frozenset[int]:
        """The places, and all that are reached from them without taking a character."""
        found, left = set(places), list(places)
        while left:
            step = self._program[left.pop()]
            if step.chars is None:
                fresh = [at for at in step.to if at not in found]
                found.update(fresh)
                left += fresh
        return frozenset(found)


class _Parser:
    """Builds the program from the end of the expression's parts to their beginning.

    Each part is given the place where to go on afterwards and returns the place where it begins.
    """

    def __init__(self, text: str, field: str) -> None:
        self._text = text
        self._field = field
        self._at = 0
        self._depth = 0
        self.program: list[_Step] = [_Step()]
        self.accept = 0

    def parse(self) -> int:
        start, end = self._either()
        if self._at < len(self._text):
            raise self._wrong("has a ) without its (")
        self.program[end] = _Step(to=(self.accept,))
        return start

    def _wrong(self, problem: str) -> InputError:
        return InputError(
            f"{problem}, at character {self._at + 1}",
            field=self._field,
            value=self._text,
            remedy="characters, . [a-z] ( ) | * + ? ^ $ \\d \\w \\s are understood",
        )

    def _add(self, step: _Step) -> int:
        self.program.append(step)
        return len(self.program) - 1

    def _peek(self) -> str:
        return self._text[self._at] if self._at < len(self._text) else ""

    def _next(self) -> str:
        char = self._peek()
        if not char:
            raise self._wrong("ends too early")
        self._at += 1
        return char

    def _either(self) -> tuple[int, int]:
        """Alternatives; returns where they begin and the open place where they end."""
        branches = [self._sequence()]
        while self._peek() == "|":
            self._at += 1
            branches.append(self._sequence())
        if len(branches) == 1:
            return branches[0]
        end = self._add(_Step())
        for _, last in branches:
            self.program[last] = _Step(to=(end,))
        return self._add(_Step(to=tuple(first for first, _ in branches))), end

    def _sequence(self) -> tuple[int, int]:
        start = end = self._add(_Step())
        while self._peek() not in ("", "|", ")"):
            first, last = self._repeated()
            self.program[end] = _Step(to=(first,))
            end = last
        return start, end

    def _repeated(self) -> tuple[int, int]:
        first, last = self._single()
        mark = self._peek()
        if not mark or mark not in "*+?":
            return first, last
        self._at += 1
        if self._peek() and self._peek() in "*+?":
            raise self._wrong("has two repetitions in a row")
        end = self._add(_Step())
        again = (first, end) if mark in "*+" else (end,)
        self.program[last] = _Step(to=again)
        start = first if mark == "+" else self._add(_Step(to=(first, end)))
        return start, end

    def _single(self) -> tuple[int, int]:
        char = self._next()
        if char == "(":
            return self._group()
        if char == "[":
            return self._one(self._bracket())
        if char == "\\":
            return self._one(self._escaped())
        if char in _SPECIAL and char not in ".^$]}":
            self._at -= 1
            raise self._wrong(f"has a {char} where it has no meaning here")
        known = {
            ".": _Chars(frozenset("\n"), others=True),
            "^": _Chars(frozenset(_START)),
            "$": _Chars(frozenset(_END)),
        }
        return self._one(known.get(char) or _Chars(frozenset(char)))

    def _one(self, chars: _Chars) -> tuple[int, int]:
        end = self._add(_Step())
        return self._add(_Step(chars, (end,))), end

    def _group(self) -> tuple[int, int]:
        if self._peek() == "?":
            self._at += 1
            if self._next() != ":":
                raise self._wrong("has a group of a kind that is not understood")
        self._depth += 1
        if self._depth > 50:
            raise self._wrong("nests groups too deeply")
        found = self._either()
        if self._next() != ")":
            raise self._wrong("has a ( without its )")
        self._depth -= 1
        return found

    def _escaped(self) -> _Chars:
        char = self._next()
        if char.lower() in _CLASSES:
            return _Chars(_CLASSES[char.lower()], others=char.isupper())
        if char.isalnum() or char in _ENDS:
            raise self._wrong(f"has the escape \\{char}")
        return _Chars(frozenset(char))

    def _bracket(self) -> _Chars:
        others = self._peek() == "^"
        self._at += others
        chars: set[str] = set()
        first = True
        while (char := self._next()) != "]" or first:
            first = False
            if char == "\\":
                escaped = self._escaped()
                if escaped.others:
                    raise self._wrong("has an excluding class within [ ]")
                chars |= escaped.chars
            elif self._peek() == "-" and self._text[self._at + 1 : self._at + 2] not in ("]", ""):
                self._at += 1
                last = self._next()
                if last == "\\" or not char <= last <= "\x7f":
                    raise self._wrong(f"has the range {char}-{last}")
                chars.update(map(chr, range(ord(char), ord(last) + 1)))
            else:
                chars.add(char)
        return _Chars(frozenset(chars) - _ENDS, others)
