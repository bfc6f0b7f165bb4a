"""The ending of a run: ``verdict.json`` in a bag (``ssp.verdict/1``), and the word to the page.

The recorder writes the file when it closes its bag in good order; ``ssp run``, which also sees
processes die, writes it anew. A recorder that was killed leaves none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping, read_mapping
from ssp_core.vocabulary import Verdict

VERDICT_FILE = "verdict.json"
SCHEMA = "ssp.verdict/1"
# Beside a bag's folder, of the run that left it.
RESULT_FILE = "result.json"
RESULT_SCHEMA = "ssp.result/1"


@dataclass(frozen=True, slots=True)
class RecordedVerdict:
    """A verdict with its reasons, the primary one first."""

    verdict: Verdict
    reasons: tuple[str, ...]

    @property
    def text(self) -> str:
        """The verdict with its first reason, for people."""
        first = f": {self.reasons[0]}" if self.reasons else ""
        return f"{self.verdict.name.lower()}{first}"


@dataclass(frozen=True, slots=True)
class EndWord:
    """The end of a run, as ``ssp run`` tells it to the operators' page: one line of JSON.

    Args:
        reasons: of the verdict, the primary one first.
        final: the recording is closed, and the verdict stands; before that it may become worse.
        folder: of the run.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    final: bool
    folder: str = ""

    def line(self) -> bytes:
        """Return the word as it is sent."""
        value = {
            "verdict": self.verdict.name.lower(),
            "reasons": list(self.reasons),
            "final": self.final,
            "folder": self.folder,
        }
        return json.dumps(value).encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> EndWord:
        """Read a line; raise ValueError for one that is no such word."""
        value = json.loads(line)
        try:
            verdict = Verdict[value["verdict"].upper()]
            reasons = tuple(str(reason) for reason in value["reasons"])
            return cls(verdict, reasons, value["final"] is True, str(value["folder"]))
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{line[:80]!r} is no end of a run") from error


def verdict_bytes(
    verdict: Verdict, reasons: Sequence[str], told_by: Literal["monitor", "runner"], seal: str = ""
) -> bytes:
    """Give what stands in the file.

    Args:
        verdict: of the run.
        reasons: for it, the primary one first.
        told_by: the one that decided it.
        seal: digest of the bag as it was before it got the verdict; empty: it isn't sealed.
    """
    value = {
        "schema": SCHEMA,
        "verdict": verdict.name.lower(),
        "reasons": list(reasons),
        "told_by": told_by,
        "seal": seal or None,
    }
    return (json.dumps(value, indent=1, sort_keys=True) + "\n").encode()


def read_verdict(bag: Path) -> RecordedVerdict | None:
    """Read the verdict in a bag's folder; None where there is none.

    Raises:
        InputError: the file is no verdict.
    """
    file = bag / VERDICT_FILE
    return _verdict(read_mapping(file), file) if file.is_file() else None


def parse_verdict(data: bytes, place: str | Path) -> RecordedVerdict:
    """Read a verdict from its bytes.

    Raises:
        InputError: they are no verdict.
    """
    return _verdict(parse_mapping(data, str(place)), place)


def _verdict(value: Mapping[str, object], place: str | Path) -> RecordedVerdict:
    words = {v.name.lower(): v for v in Verdict}
    word, reasons = value.get("verdict"), value.get("reasons")
    has_verdict = isinstance(word, str) and word in words
    if value.get("schema") != SCHEMA or not has_verdict or not isinstance(reasons, list):
        raise InputError(
            "is no verdict of a run",
            file=place,
            value=value,
            remedy="it is written by `ssp run`; record the run again",
        )
    return RecordedVerdict(words[str(word)], tuple(str(reason) for reason in reasons))
