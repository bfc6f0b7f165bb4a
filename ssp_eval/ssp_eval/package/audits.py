"""Audits of a package, made again from the recordings in it and compared with what is written."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.files import parse_model
from ssp_eval.audit.judge import judge
from ssp_eval.audit.model import Audit, RecordingEntry
from ssp_eval.audit.recording import Recording, read_recording
from ssp_eval.package.contents import nearest
from ssp_eval.package.index import Index, Problem
from ssp_eval.package.model import FileEntry
from ssp_scenario_manager.event_spec.model import Event

# Where the recordings lay decides nothing, and neither does who judged them.
_FREE_OF_AUDIT = {"software", "recordings", "labels"}
# Labels may be reviewed after the audit, which only counted them.
_FREE_OF_RECORDING = {"bag", "name", "labels"}
# Another processor may round the last digits another way; no verdict hangs on a millionth.
_TOLERANCE = 1e-6
_SHOWN = 8
_WIDEST = 100

_Difference = tuple[str, str]


class Audits:
    """Judges recordings again, and keeps where an audit says something else.

    Args:
        index: of the package.
        on_step: told what is done next, since reading a recording takes some seconds.
    """

    def __init__(self, index: Index, on_step: Callable[[str], None] = lambda _: None) -> None:
        self._index = index
        self._contents = index.contents
        self._on_step = on_step
        self.problems: list[Problem] = []
        self.notes: list[str] = []

    def check(self) -> None:
        """Every audit of the package; one whose links lead nowhere is a problem already."""
        for entry in self._contents.of("audit"):
            try:
                self._check(entry)
            except InputError as error:
                text = f"can't be made again: {error}"
                self.problems.append(Problem(entry.path, "", text))

    def _check(self, entry: FileEntry) -> None:
        try:
            told = parse_model(Audit, self._contents.mapping(entry), entry.path)
        except InputError:
            return  # its links say so
        places = [self._index.place_of(recording) for recording in told.recordings]
        events = self._index.events.get(str(told.event_version), ())
        event_file = nearest(events, entry.path)
        if any(place is None for place in places) or (
            told.event_version is not None and event_file is None
        ):
            return
        found = self._again([p for p in places if p is not None], self._event(event_file))
        if told.software != found.software:
            self.notes.append(
                f"{entry.path}: made by {told.software}, compared with what ssp {__version__} gives"
            )
        wrong = list(_compare(told, found))
        self.problems += [Problem(entry.path, at, text) for at, text in wrong[:_SHOWN]]
        if len(wrong) > _SHOWN:
            text = f"{len(wrong) - _SHOWN} more values aren't what the recordings give"
            self.problems.append(Problem(entry.path, "", text))

    def _event(self, entry: FileEntry | None) -> Event | None:
        if entry is None:
            return None
        return parse_model(Event, self._contents.mapping(entry), entry.path)

    def _again(self, places: Sequence[FileEntry], event: Event | None) -> Audit:
        """The audit of recordings, each laid out as it lay when it was taken in."""
        with tempfile.TemporaryDirectory(prefix="ssp-package-") as scratch:
            recordings: list[Recording] = []
            try:
                for number, place in enumerate(places):
                    self._on_step(f"judging {place.path}")
                    root = Path(scratch) / str(number)
                    recordings.append(read_recording(self._contents.lay_out(place, root)))
                return judge(recordings, event).audit
            except InputError as error:
                text = str(error)
                for number in range(len(places)):
                    text = text.replace(f"{Path(scratch) / str(number)}/", "")
                raise InputError(text) from error


def _compare(told: Audit, found: Audit) -> Iterator[_Difference]:
    """What differs, verdicts first: they are what others go by."""
    pairs = list(zip(told.recordings, found.recordings, strict=True))
    for number, (one, other) in enumerate(pairs):
        if one.status != other.status:
            yield _says(f"recordings[{number}].status", one.status, other.status)
    for number, (one, other) in enumerate(pairs):
        codes = [_codes(one), _codes(other)]
        if codes[0] != codes[1]:
            yield _says(f"recordings[{number}].reasons", *codes)
        elif differing := list(
            _differences(f"recordings[{number}].reasons", _json(one)["reasons"],
                         _json(other)["reasons"])
        ):  # fmt: skip
            yield from differing
    for number, (one, other) in enumerate(pairs):
        seen = {"status", "reasons"} | _FREE_OF_RECORDING
        yield from _keys(f"recordings[{number}].", _json(one), _json(other), seen)
    yield from _keys("", _json(told), _json(found), _FREE_OF_AUDIT)


def _codes(entry: RecordingEntry) -> list[str]:
    return [found.code for reason in entry.reasons for found in (reason, *reason.consequences)]


def _json(value: Audit | RecordingEntry) -> dict[str, Any]:
    return value.model_dump(mode="json", by_alias=True)


def _keys(
    prefix: str, told: dict[str, Any], found: dict[str, Any], without: set[str]
) -> Iterator[_Difference]:
    for key in told:
        if key not in without:
            yield from _differences(f"{prefix}{key}", told[key], found[key])


def _differences(at: str, told: Any, found: Any) -> Iterator[_Difference]:
    """Field and text of each value that differs."""
    if isinstance(told, dict) and isinstance(found, dict):
        for key in sorted({*told, *found}):
            if key in told and key in found:
                yield from _differences(f"{at}.{key}", told[key], found[key])
            elif key in told:
                yield f"{at}.{key}", "isn't among what the recordings give"
            else:
                yield f"{at}.{key}", f"is missing; the recordings give {_short(found[key])}"
    elif isinstance(told, list) and isinstance(found, list) and len(told) == len(found):
        for number, (one, other) in enumerate(zip(told, found, strict=True)):
            yield from _differences(f"{at}[{number}]", one, other)
    elif not _same(told, found):
        yield _says(at, told, found)


def _same(told: Any, found: Any) -> bool:
    numbers = [
        value for value in (told, found)
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]  # fmt: skip
    if len(numbers) == 2:
        return math.isclose(*numbers, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    return type(told) is type(found) and bool(told == found)


def _says(at: str, told: Any, found: Any) -> _Difference:
    return at, f"says {_short(told)}, and the recordings give {_short(found)}"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 1]}…"
