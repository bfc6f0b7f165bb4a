"""``verdict.json`` in a bag (``ssp.verdict/1``): how a run ended, by who saw its end.

The recorder writes it when it closes its bag in good order; ``ssp run``, which also sees processes
die, writes it anew. A recorder that was killed leaves none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ssp_core.errors import InputError
from ssp_core.files import read_mapping, write_json
from ssp_core.vocabulary import Verdict

VERDICT_FILE = "verdict.json"
SCHEMA = "ssp.verdict/1"


@dataclass(frozen=True, slots=True)
class RecordedVerdict:
    """A verdict with its reasons, the primary one first."""

    verdict: Verdict
    reasons: tuple[str, ...]


def write_verdict(
    bag: Path, verdict: Verdict, reasons: Sequence[str], told_by: Literal["monitor", "runner"]
) -> None:
    """Writes the file into a bag's folder, over one that is there."""
    write_json(
        bag / VERDICT_FILE,
        {
            "schema": SCHEMA,
            "verdict": verdict.name.lower(),
            "reasons": list(reasons),
            "told_by": told_by,
        },
    )


def read_verdict(bag: Path) -> RecordedVerdict | None:
    """What the file in a bag's folder says; None where there is none.

    Raises:
        InputError: the file is no verdict.
    """
    file = bag / VERDICT_FILE
    if not file.is_file():
        return None
    value = read_mapping(file)
    words = {v.name.lower(): v for v in Verdict}
    word, reasons = value.get("verdict"), value.get("reasons")
    known = isinstance(word, str) and word in words
    if value.get("schema") != SCHEMA or not known or not isinstance(reasons, list):
        raise InputError(
            "is no verdict of a run",
            file=file,
            value=value,
            remedy="it is written by `ssp run`; record the run again",
        )
    return RecordedVerdict(words[str(word)], tuple(str(reason) for reason in reasons))
