"""The fault matrix: what is struck and what is expected of it (library/faults/matrix.yaml)."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import TypeAdapter

from ssp_core.run_file.model import FaultKind, RunSpec

_FILE = Path(__file__).parent.parent / "library" / "faults" / "matrix.yaml"


class Stage(Enum):
    """The time in a run at which a fault strikes; the value is the word of tables and options."""

    ARMED = "armed"
    BEFORE = "before"
    AFTER = "after"
    CONFLICT = "conflict"

    @property
    def title(self) -> str:
        """Name the stage for people."""
        return _TITLES[self]


_TITLES = {
    Stage.ARMED: "armed",
    Stage.BEFORE: "before trigger",
    Stage.AFTER: "after trigger",
    Stage.CONFLICT: "in conflict",
}
_SHORT = {"all": tuple(Stage), "running": (Stage.BEFORE, Stage.AFTER, Stage.CONFLICT)}
Clock = Literal["session", "wall"]


@dataclass(frozen=True, slots=True)
class Within:
    """A bound on the reaction time: a limit of the site and what is added to it.

    Args:
        extra_s: stated allowance: steps until it is seen and reported, process scheduling.
        limit: field of the run's limits or end that the watch behind it uses, None for none.
        clock: session time, or the wall's where session time stands still or doesn't count.
    """

    extra_s: float
    limit: str | None = None
    clock: Clock = "session"

    def seconds(self, run: RunSpec) -> float:
        """Return the bound in a run, s."""
        if self.limit is None:
            return self.extra_s
        holder = run.limits if hasattr(run.limits, self.limit) else run.end
        return self.extra_s + float(getattr(holder, self.limit))

    @property
    def text(self) -> str:
        """Tell people where the number comes from."""
        parts = [self.limit] if self.limit else []
        parts.append(f"{self.extra_s:g} s")
        return " + ".join(parts) + (" on the wall's clock" if self.clock == "wall" else "")


# From where a stopping distance and a reaction time are counted.
From = Literal["fault", "motion", "trigger", "abort"]


@dataclass(frozen=True, slots=True)
class ExpectedOutcome:
    """The outcome that a cell must have.

    Args:
        verdicts: any of them.
        why: for people: why this is right.
        by: who reacts, for people; empty where there is nothing to react to.
        primary: beginnings of the first reason, any of them; none for a valid run.
        also: limits that the other reasons and the safety events may name, as consequences.
        within: bound on the reaction time; None: there is nothing to react to.
        lockstep: the same in lockstep, where it differs: watches of processes count the wall's
            clock there while session time stands still.
        blind: how long VUT and objects may drive on from there, for the stopping distance; the
            bound on the reaction time where it isn't given.
        signs: limits whose event counts as the reaction; empty: any, and the session's abort.
        since: from where reaction and stopping distance are counted. ``motion``: the object
            stands when it is struck, and only its next motion can show it; ``trigger``: only what
            the trigger asks for can show it; ``abort``: the fault endangers no road user, so that
            distances count from the abort.
        stops: True: the run is broken off, and everything must stop within its bound.
        starts: False: the armed session must not start.
        loses: True: messages may be missing from the bag; that is the fault.
        may_end_first: True: a run that is complete before the watch has noticed is as good.
    """

    verdicts: frozenset[str]
    why: str
    by: str = ""
    primary: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    within: Within | None = None
    lockstep: Within | None = None
    blind: Within | None = None
    signs: tuple[str, ...] = ()
    since: From = "fault"
    stops: bool = True
    starts: bool = True
    loses: bool = False
    may_end_first: bool = False

    def bound(self, mode: str) -> Within | None:
        """Return the bound on the reaction time in a mode."""
        return self.lockstep if mode == "lockstep" and self.lockstep is not None else self.within


@dataclass(frozen=True, slots=True)
class NotApplicable:
    """A cell that can't be, and why."""

    reason: str


Cell = ExpectedOutcome | NotApplicable
# Stands for the id of the OT whose manoeuvre is the event.
OT = "OT"


@dataclass(frozen=True, slots=True)
class Row:
    """One fault of the matrix.

    Args:
        name: short and unique, for options, folders and tables.
        title: for people.
        kind: of the injected fault.
        target: node or object, or ``OT``; empty for the session.
        value: size, in the kind's unit.
        duration_s: how long it lasts, None for good.
        cells: by stage.
        standing: instead of them where the struck object stands at the fault's instant.
    """

    name: str
    title: str
    kind: FaultKind
    cells: dict[Stage, Cell]
    target: str = ""
    value: float | None = None
    duration_s: float | None = None
    standing: dict[Stage, Cell] = field(default_factory=dict)

    def cell(self, stage: Stage, moves: bool) -> Cell:
        """Return the expected outcome of this row at a stage.

        Args:
            stage: when the fault strikes.
            moves: whether the initiator moves at that instant, or will with the start.
        """
        if not moves and stage in self.standing:
            return self.standing[stage]
        return self.cells[stage]


def read_rows(path: Path = _FILE) -> tuple[Row, ...]:
    """Return the rows of a matrix file, in its order."""
    document = yaml.safe_load(path.read_text())
    times: dict[str, float] = document["times"]

    def cell_of(cell: dict[str, Any]) -> dict[str, Any]:
        bounds = {key: cell[key] for key in ("within", "lockstep", "blind") if key in cell}
        extra = {
            key: sum(times.get(part, part) for part in bound["extra_s"])
            for key, bound in bounds.items()
        }
        return {**cell, **{key: {**bounds[key], "extra_s": s} for key, s in extra.items()}}

    def cells_of(cells: dict[str, dict[str, Any]]) -> dict[Stage, Any]:
        return {
            stage: cell_of(cell)
            for word, cell in cells.items()
            for stage in _SHORT.get(word) or (Stage(word),)
        }

    for row in document["rows"]:
        for key in {"cells", "standing"} & row.keys():
            row[key] = cells_of(row[key])
    return TypeAdapter(tuple[Row, ...]).validate_python(document["rows"])


MATRIX = read_rows()
