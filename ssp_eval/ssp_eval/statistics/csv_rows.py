"""Rows of scores from a CSV file: published tables, and cells that others scored."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model, model_validator

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_text
from ssp_core.vocabulary import DOMAINS_READ, read_domain
from ssp_eval.evaluate.clients.models import is_control_name
from ssp_eval.score.aggregate import EQUAL
from ssp_eval.score.cli import NULL
from ssp_eval.score.metrics import METRIC_NAMES, METRICS
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.names import control_names
from ssp_eval.statistics.rows import MACRO, OK, CellRow, doubtful
from ssp_eval.statistics.table import unguarded

# Null as tables write it: nothing, or a dash of any length.
_NULLS = ("", NULL, "—", "-", "−")
_RESPONSE = re.compile(r"S@(\d+(?:\.\d+)?)", re.ASCII)
# A table of models alone, each line a mean over everything, may lack both.
_OF_CELLS = ("scenario", "domain")
COLUMNS = (
    *_OF_CELLS,
    "model",
    "jovr",
    "sem_acc_eff",
    "cia_eff",
    "act_acc_eff",
    "tqsr",
    "atc_eff",
    "risk",
)
_NUMBERS = frozenset({*METRIC_NAMES, "n", "seed", "lost", "total_b", "active_b"})
_FACTS = ("total_b", "active_b", "architecture")
_MOST_COLUMNS = 1000
# The first of two shares counts some of what the second counts (METHOD 6.3, 6.7).
_PARTS = (("tqsr", "stfr"), ("sem_acc_eff", "sem_cov"), ("sem_acc_eff", "sem_acc_soft"))
_ROUNDING = 0.01 + EQUAL  # of shares in print
_MOST = 2**53  # that a number of a table holds to the last digit


def _domain(text: str) -> str:
    word = MACRO if text.casefold() == MACRO else read_domain(text)
    if word is None:
        raise ValueError(f"is no domain; known: {DOMAINS_READ}, and {MACRO} for a mean over them")
    return word


Name = Annotated[str, AfterValidator(unguarded), Field(min_length=1)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Seconds = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Billions = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class _Cell(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)

    scenario: Annotated[Name, AfterValidator(lambda x: MACRO if x.casefold() == MACRO else x)]
    domain: Annotated[str, AfterValidator(_domain)]
    model: Name


_SCORES: dict[str, Any] = {m.name: ((Seconds if m.unit else Share) | None, None) for m in METRICS}


class _Line(
    create_model("_Scores", __base__=_Cell, **_SCORES)  # type: ignore[misc]  # of METRICS
):
    """One line; a field that is null in the file has its default."""

    risk: str | None = None
    n: Annotated[int, Field(ge=1, le=_MOST)] | None = None
    run: Annotated[str, AfterValidator(unguarded)] = ""
    seed: Annotated[int, Field(ge=0, le=_MOST)] | None = None
    total_b: Billions | None = None
    active_b: Billions | None = None
    architecture: Annotated[str, AfterValidator(unguarded)] = ""
    control: bool = False
    admitted: bool = True
    stand_in: bool = False
    status: Literal["ok", "refused", "failed"] = "ok"
    reason: Annotated[str, AfterValidator(unguarded)] = ""
    lost: Annotated[int, Field(ge=0, le=_MOST)] = 0
    thresholds: Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")] = ""
    declared_by: Annotated[str, AfterValidator(unguarded)] = ""

    @property
    def is_macro(self) -> bool:
        return MACRO in (self.scenario, self.domain)

    @property
    def says_model(self) -> bool:
        """Tell whether the file itself says that the row is of a model."""
        return "control" in self.model_fields_set and not self.control

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        scores = [name for name in METRIC_NAMES if getattr(self, name) is not None]
        if self.status != OK and (scores or self.risk):
            raise ValueError(f"a cell that is {self.status} has no scores; leave them empty")
        if self.status == OK and (self.jovr is None or self.tqsr is None):
            raise ValueError("jovr and tqsr are never null: their denominator counts the labels")
        if self.active_b is not None and self.active_b > (self.total_b or self.active_b):
            raise ValueError("active_b is more than total_b")
        if self.says_model and is_control_name(self.model):
            raise ValueError(
                f"{self.model} is the name of a control, and the column control says that it is "
                "none: name the model otherwise"
            )
        for name, whole in _PARTS:
            part, most = getattr(self, name), getattr(self, whole)
            if part is not None and most is not None and part - most > _ROUNDING:
                raise ValueError(f"{name} is {part:g}, more than {whole}, {most:g}: check the two")
        self._check_response()
        return self

    def _check_response(self) -> None:
        if self.is_macro:
            if self.risk is not None:
                raise ValueError(
                    "risk is the response of a single cell; a macro row has rsr, the share of "
                    "cells with a response, and rl_s, their mean latency in seconds"
                )
            if self.rl_s is not None and not self.rsr:
                raise ValueError("rl_s is given where no cell has a response")
        elif self.risk is not None:
            if self.rsr is not None or self.rl_s is not None:
                raise ValueError("risk says what rsr and rl_s say: give one of the two")
            if self.risk != "F" and not _RESPONSE.fullmatch(self.risk):
                raise ValueError("risk must be S@1.50 for a response after 1.50 s, or F for none")
        elif self.rsr not in (None, 0.0, 1.0):
            raise ValueError(
                "rsr is neither 1 nor 0: give each run of a cell a line of its own; of a mean over "
                f"cells, write {MACRO} as its scenario, domain or both"
            )
        elif self.rsr == 1.0 and self.rl_s is None:
            raise ValueError("rl_s is missing for a response")
        elif self.rl_s is not None and not self.rsr:
            raise ValueError("rl_s is given where there is no response: leave it empty")

    def row(self) -> CellRow:
        values = self.model_dump(exclude={"risk", "ivcs"})
        if self.risk is not None:
            match = _RESPONSE.fullmatch(self.risk)
            values |= {"rsr": int(match is not None), "rl_s": float(match[1]) if match else None}
        elif not self.is_macro and self.rsr is not None:
            values["rsr"] = int(self.rsr)
        if self.thresholds == DEFAULT.sha256:
            values["thresholds"] = ""
        values["control"] = self.control or is_control_name(self.model)
        return CellRow(**values)


@dataclass(frozen=True)
class _Read:
    """A line of the file as a row.

    Args:
        ivcs: as the file gives it, and one unit of its last digit.
        named: it says whether it is a control.
    """

    number: int
    row: CellRow
    ivcs: tuple[float, float] | None
    named: bool


def rows_from_csv(path: Path, tell: Callable[[str], None] = lambda _note: None) -> list[CellRow]:
    """Return the rows of a CSV file of component scores, cells or macro rows.

    IVCS of a cell is computed (METHOD 6.10). That of a macro row, a published mean over scenarios,
    domains or both, is taken as given: a mean over cells follows from the mean components only
    where none of them was null. Where nothing in the file tells of an audit, all cells count as
    admitted.

    Args:
        path: with a header naming COLUMNS in any order, and any other field of _Line. Without
            scenario and domain every line is a macro row. Lines before the header that begin with
            ``#`` are notes.
        tell: called with what was left aside, a sentence each.

    Raises:
        InputError: it can't be read, a column is missing or doubled, a value is wrong, a cell
            stands twice, cells and macro rows are mixed, or facts of a model contradict each
            other; with its line.
    """
    first_lines: dict[tuple[object, ...], int] = {}
    facts: dict[str, _Read] = {}
    rows: list[CellRow] = []
    unnamed: list[str] = []
    others: list[tuple[float, int, str]] = []
    for read in _lines(path, tell):
        line, row = read.number, read.row
        if rows and row.over != rows[0].over:
            raise InputError(
                f"is {_kind(row)}, and the lines before are {_kind(rows[0])}",
                file=path,
                line=line,
                remedy="analyse them apart: what is averaged already can't be averaged with cells",
            )
        first = first_lines.setdefault((*row.key, row.run, row.seed), line)
        if first != line:
            raise InputError(
                f"cell {' / '.join(row.key)} stands in line {first} already",
                file=path,
                line=line,
                remedy="give each cell once, or tell its runs apart in a column run or seed",
            )
        before = facts.setdefault(row.model, read)
        for name in _FACTS:
            if getattr(row, name) != getattr(before.row, name):
                raise InputError(
                    f"differs for {row.model} from line {before.number}",
                    file=path,
                    line=line,
                    field=name,
                    value=getattr(row, name),
                    remedy="a model has one value in all its lines",
                )
        if read.ivcs is not None and row.ivcs is not None:
            file_ivcs, unit = read.ivcs
            if abs(file_ivcs - row.ivcs) > unit:
                text = f"{file_ivcs:g} there, {row.ivcs:.4f} computed"
                others.append((abs(file_ivcs - row.ivcs), line, text))
            if row.over and file_ivcs != row.ivcs:
                row = replace(row, weighted=file_ivcs)
        if not read.named:
            unnamed.append(row.model)
        rows.append(row)
    if not rows:
        raise InputError("holds no cells", file=path, remedy="give one line per cell")
    if others:
        _, line, example = max(others)
        rule = (
            "ivcs of macro rows is taken as given; from their components (METHOD 6.10) follows"
            if rows[0].over
            else "ivcs follows from the components (METHOD 6.10) and is computed; the file has"
        )
        tell(
            f"{path}: {rule} another value in {len(others)} of {len(rows)} lines, most so in line "
            f"{line}: {example}."
        )
    for text in (*control_names(unnamed), *(text for text, _ in doubtful(rows))):
        tell(f"{path}: {text[0].lower()}{text[1:]}")
    return rows


def _kind(row: CellRow) -> str:
    return f"a mean over {'s and '.join(sorted(row.over))}s" if row.over else "a cell"


def _lines(path: Path, tell: Callable[[str], None]) -> Iterator[_Read]:
    text = read_text(path).removeprefix("\ufeff")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    names: list[str] = []
    while True:
        number = reader.line_num + 1  # where a row begins, whatever lines it spans
        try:
            fields = next(reader, None)
        except csv.Error as error:
            raise InputError(
                f"is no CSV: {error}",
                file=path,
                line=number,
                remedy="write it as CSV, with a closed quote in each line",
            ) from error
        if fields is None:
            break
        fields = [field.strip() for field in fields]
        if not any(fields) or (not names and fields[0].startswith("#")):
            continue
        if not names:
            names = _checked_names(fields, path, number, tell)
            continue
        if len(fields) != len(names):
            raise InputError(
                f"has {len(fields)} fields, the header has {len(names)}",
                file=path,
                line=number,
                remedy="separate by commas, write decimals with a point, and put a field that "
                'holds a comma in double quotes (")',
            )
        yield _read(dict(zip(names, fields, strict=True)), path, number)
    if not names:
        remedy = f"begin with {','.join(COLUMNS)}"
        raise InputError("is empty", file=path, line=1, remedy=remedy)


def _of_row(path: Path, error: InputError) -> InputError:
    return InputError(
        error.problem,
        file=path,
        field=error.field,
        value=None if isinstance(error.value, dict) else error.value,
        remedy="scores are shares from 0 to 1 with a decimal point; null is an empty field or a "
        "dash",
    )


def _read(fields: Mapping[str, str], path: Path, number: int) -> _Read:
    entries: dict[str, Any] = {key: text for key, text in fields.items() if text not in _NULLS}
    if not set(_OF_CELLS) & fields.keys():
        entries |= dict.fromkeys(_OF_CELLS, MACRO)
    try:
        _check_numbers(entries)
        line = parse_model(_Line, entries, path)
    except InputError as error:
        raise error.each(partial(_of_row, path)).in_line(number) from error
    has_control = "control" in line.model_fields_set
    if line.ivcs is None:
        return _Read(number, line.row(), None, has_control)
    unit = max(1e-9, 10.0 ** -len(fields["ivcs"].partition(".")[2]))
    return _Read(number, line.row(), (line.ivcs, unit), has_control)


def _check_numbers(entries: Mapping[str, Any]) -> None:
    """Raise InputError where digits are grouped by underscores, which the model would read."""
    for key in _NUMBERS.intersection(entries):
        if isinstance(entries[key], str) and "_" in entries[key]:
            raise InputError(
                "is no number",
                field=key,
                value=entries[key],
                remedy="write its digits without underscores",
            )


def _checked_names(
    names: list[str], path: Path, number: int, tell: Callable[[str], None]
) -> list[str]:
    if len(names) > _MOST_COLUMNS:
        raise InputError(
            f"has {len(names)} columns, at most {_MOST_COLUMNS} are read",
            file=path,
            line=number,
            remedy=f"keep {', '.join(COLUMNS)} and what else is read of a table",
        )
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise InputError(
            "has a column twice",
            file=path,
            line=number,
            value=doubled[0],
            remedy="keep one of the two",
        )
    needed = [name for name in COLUMNS if name != "risk" or "rsr" not in names]
    if "rsr" in names and not set(_OF_CELLS) & set(names):
        needed = [name for name in needed if name not in _OF_CELLS]
        tell(
            f"{path}: has no columns scenario and domain: each line is taken for a mean over all "
            "of them."
        )
    if missing := [name for name in needed if name not in names]:
        raise InputError(
            f"misses the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
            file=path,
            line=number,
            remedy="an empty field stands for null, but the column must be there",
        )
    # What our own remark says stands in other columns too.
    column_names = (*_Line.model_fields, "remark")
    if ignored := [name for name in names if name not in column_names]:
        ignored_names = ", ".join(name or "one without a name" for name in ignored)
        known_names = ", ".join(_Line.model_fields)
        tell(f"{path}: columns that are ignored: {ignored_names}. Known are {known_names}.")
    return names
