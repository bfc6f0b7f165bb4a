"""The findings of an import that keep a source from being taken as it is, unless a person accepts.

All findings of an import are listed in one message, each with its name. ``--accept NAME`` takes
the findings of that name as they are; import.json and every later page say so.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ssp_core.errors import InputError
from ssp_eval.data.provenance import AcceptedFinding

# What ``--accept NAME`` takes as it is.
ACCEPTABLE: Mapping[str, str] = {
    "camera_matrix": "a CameraInfo that no camera of these frames has",
    "clock_step": "a clock that steps while an object moves",
    "damaged_video": "a video of which the decoder reports errors",
    "cut_pictures": "JPEGs that are cut off or damaged, as far as they go",
    "heading": "headings that contradict the direction of motion",
    "leap": "places that leap",
    "leaping_stamps": "frames whose stamps leap, at their times of receipt",
    "sideways": "a vehicle that moves across its heading",
    "speed": "speeds that contradict the positions",
    "twist_axes": "a twist along other axes than its child frame's",
}


@dataclass(frozen=True)
class Finding:
    """One thing in a source that contradicts it, or that can't be taken as it is.

    Args:
        name: of its kind, a key of ACCEPTABLE where it is acceptable.
        problem: what is wrong, as one clause, with the time from which on it is.
        field: topic, id of the table, or option.
        line: of the table.
        acceptable: False: the import can't be made with it.
    """

    name: str
    problem: str
    remedy: str
    file: Path
    field: str | None = None
    line: int | None = None
    value: object = None
    acceptable: bool = True

    @property
    def error(self) -> InputError:
        """The refusal, which says how a person accepts it."""
        how = f"; --accept {self.name} takes it as it is" if self.acceptable else ""
        return InputError(
            f"{self.problem} [{self.name}]",
            file=self.file,
            line=self.line,
            field=self.field,
            value=self.value,
            remedy=self.remedy + how,
        )

    @property
    def record(self) -> AcceptedFinding:
        """Return the entry of import.json for an accepted finding."""
        plain = InputError(
            self.problem, line=self.line, field=self.field, value=self.value, remedy=None
        )
        return AcceptedFinding(name=self.name, text=str(plain)[:500])


@dataclass
class Part:
    """One part of an import; True: an error ended it."""

    has_ended: bool = False


class Findings:
    """The findings of one import.

    Args:
        accepted: names that a person takes as they are.
    """

    def __init__(self, accepted: Collection[str] = ()) -> None:
        self._names = frozenset(accepted)
        self._refused: list[InputError] = []
        self._accepted: list[AcceptedFinding] = []
        self._lacks = False

    def add(self, finding: Finding) -> None:
        """Note a finding; the import goes on, so that all of them are listed in one go."""
        if finding.acceptable and finding.name in self._names:
            self._accepted.append(finding.record)
        else:
            self._refused.append(finding.error)

    @contextmanager
    def noted(self, name: str) -> Iterator[Part]:
        """Note an error of one part under a name; the other parts are gone through all the same.

        ``need`` ends the import before what the part was to give is used.
        """
        part = Part()
        try:
            yield part
        except InputError as error:
            part.has_ended = True
            if all(error is not one for one in self._refused):  # which ``need`` raises
                self.note(name, error)

    def note(self, name: str, error: InputError) -> None:
        """Note an error under the name of its part, which then gives nothing to go on with."""
        self._lacks = True
        self._refused.append(
            InputError(
                f"{error.problem} [{name}]",
                file=error.file,
                line=error.line,
                field=error.field,
                value=error.value,
                remedy=error.remedy,
            )
        )

    def need(self) -> None:
        """Raise InputError where a part ended; within ``listed``."""
        if self._lacks:
            self.check()

    @property
    def accepted(self) -> list[AcceptedFinding]:
        """The findings that a person took as they are."""
        return list(self._accepted)

    def check(self) -> None:
        """Raise InputError where a finding isn't accepted; within ``listed``."""
        if self._refused:
            raise self._refused[-1]

    @contextmanager
    def listed(self, source: Path) -> Iterator[None]:
        """Name all findings in the error that ends the import.

        Args:
            source: that is imported.

        Raises:
            InputError: with all findings, and with another error that ended the import.
        """
        try:
            yield
            self.check()
        except InputError as error:
            errors = [one for one in self._refused if one is not error]
            if not errors:
                raise
            raise InputError.of_all([*errors, error], source) from error
