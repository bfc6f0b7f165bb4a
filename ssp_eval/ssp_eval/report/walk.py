"""From the score of a record back to K*, step by step, each with its hash (METHOD 4)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ssp_core.hashing import sha256_bytes
from ssp_eval.evaluate.cell_file import CELLS, RECORDS_FILE, SCORE_FILE, frame_path
from ssp_eval.evaluate.store import RAW_FILE, REQUESTS_FILE
from ssp_eval.report.load import CellData, json_object
from ssp_eval.score import Judgement

_NO_RECORD = "no record"
_ATTACHED = "attached to the recording"
# Characters of a raw answer that a page shows; the file has them all.
_MOST_SHOWN = 20_000


@dataclass(frozen=True)
class WalkStep:
    """One link of the way.

    Args:
        what: score, evidence, raw output and so on.
        sha256: of the file, the line or the content; empty where there is nothing.
        path: from the campaign folder, empty where it isn't in it.
        says: what is to be known of it.
        content: the line, where reading it in the page helps; of a very long one its beginning.
    """

    what: str
    sha256: str
    path: str = ""
    says: str = ""
    content: str = ""


@dataclass(frozen=True)
class _Line:
    number: int
    text: str

    @property
    def sha256(self) -> str:
        """As an evidence package names it."""
        return sha256_bytes(self.text.encode())


class Walks:
    """The ways back of one cell's records; its files are read once.

    Args:
        cell: scored.

    Raises:
        InputError: a raw answer is damaged.
    """

    def __init__(self, cell: CellData) -> None:
        self._cell = cell
        self._asked_for = cell.requests
        self._place = f"{CELLS}/{cell.id}"
        self._records = _lines(cell.folder / RECORDS_FILE)
        self._requests = _lines(cell.folder / REQUESTS_FILE)
        raw = cell.folder / RAW_FILE
        self._raw = {
            str(json_object(line.text, raw, line.number).get("request_id")): line
            for line in _lines(raw)
        }

    def of(self, index: int, judgement: Judgement) -> tuple[WalkStep, ...]:
        """The way back of one label time.

        Args:
            index: of the label.
            judgement: of its record.
        """
        return tuple(self._steps(index, judgement))

    def _steps(self, index: int, judgement: Judgement) -> Iterator[WalkStep]:
        hashes, facts = self._cell.facts.hashes, self._cell.facts
        says = f"label {index}, in {SCORE_FILE}"
        yield WalkStep("score", hashes.get("score") or "", f"{self._place}/{SCORE_FILE}", says)
        if judgement.record is None:
            yield WalkStep("evidence", "", f"{self._place}/{RECORDS_FILE}", _NO_RECORD)
        else:
            line = self._records[judgement.record]
            yield self._line("evidence", RECORDS_FILE, line)
        yield from self._asked(index, judgement)
        yield WalkStep("recording", hashes.get("bag") or "", says=facts.clip.origin)
        # Sessions carry what they were made from; an imported video was made from nothing of ours.
        says = _ATTACHED if facts.clip.verdict is not None else ""
        if facts.task_version is not None:
            yield WalkStep("compiled task", facts.task_version, says=says)
        yield WalkStep("K*", facts.event_version, says=says or "as declared for this video")

    def _asked(self, index: int, judgement: Judgement) -> Iterator[WalkStep]:
        """Raw output, request and frames: of the request that the record came from."""
        requests = self._asked_for
        if judgement.record is not None:
            at = (k for k, r in enumerate(requests) if r.get("t_s") == judgement.record_t_s)
            index = next(at, index)
        if index >= len(requests):
            return
        request = requests[index]
        raw = self._raw.get(str(request.get("request_id")))
        if raw is not None:
            yield self._line("raw output", RAW_FILE, raw, whole=True)
        frames = request.get("frames", [])
        if frames:
            yield self._line("request", REQUESTS_FILE, self._requests[index])
        for frame in frames:
            digest = str(frame["sha256"])
            kept = frame_path(self._cell.folder.parents[1], digest)
            there = f"{kept.parent.name}/{kept.name}" if kept.is_file() else ""
            says = f"stamp {frame.get('stamp_ns')} ns{'' if there else ', in the recording'}"
            yield WalkStep("frame sent", digest, there, says)

    def _line(self, what: str, file: str, line: _Line, whole: bool = False) -> WalkStep:
        content = _shown(line.text) if whole else ""
        place = f"{self._place}/{file}"
        return WalkStep(what, line.sha256, place, f"line {line.number} of {file}", content)


def _shown(text: str) -> str:
    more = len(text) - _MOST_SHOWN
    return text if more <= 0 else f"{text[:_MOST_SHOWN]}… and {more} more characters in the file"


def _lines(file: Path) -> list[_Line]:
    """The lines of a JSON Lines file that aren't empty, numbered from 1; none if it isn't there."""
    text = file.read_text("utf-8") if file.is_file() else ""
    return [_Line(k, line) for k, line in enumerate(text.split("\n"), start=1) if line.strip()]
