"""Component scores from a CSV file: a matrix that was published, or the ``matrix.csv`` of ours."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import read_text
from ssp_eval.analysis.cell_fields import parse_ivcs, parse_row
from ssp_eval.analysis.row import MACRO, CellRow
from ssp_eval.strict import Place

COLUMNS = (
    "scenario",
    "domain",
    "model",
    "jovr",
    "sem_acc_eff",
    "cia_eff",
    "act_acc_eff",
    "tqsr",
    "atc_eff",
    "risk",
)
OPTIONAL_COLUMNS = ("sem_cov", "total_b", "active_b", "architecture", "run", "seed")
# What our own matrix.csv has besides. It gives the risk response as rsr and rl_s.
OWN_COLUMNS = (
    "rsr", "rl_s", "n", "sem_acc_cond", "sem_acc_soft", "stfr", "control", "admitted",
    "stand_in", "status", "reason", "thresholds",
)  # fmt: skip
# Follows from the others, and is only compared; what our remark says stands in other columns too.
_COMPUTED, _REMARK = "ivcs", "remark"
_READ = (*COLUMNS, *OPTIONAL_COLUMNS, *OWN_COLUMNS, _COMPUTED)
# What tables for people call a column, where that may mean another score as well.
_LIKELY = {
    "semacc": "sem_acc_eff", "cia": "cia_eff", "actacc": "act_acc_eff", "atc": "atc_eff",
    "ciaeff": "cia_eff", "rl": "rl_s", "latency": "rl_s", "method": "model", "params": "total_b",
    "response": "risk", "riskresponse": "risk",
}  # fmt: skip
_FACTS = ("total_b", "active_b", "architecture")
# A table of models alone, each line a mean over everything, may lack both.
_OF_CELLS = ("scenario", "domain")

Tell = Callable[[str], None]


def rows_from_csv(path: Path, tell: Tell = lambda note: None) -> list[CellRow]:
    """The rows of a CSV file of component scores, cells or macro rows.

    IVCS of a cell is computed (METHOD 6.10). That of a macro row, a published mean over scenarios,
    domains or both, is taken as given: a mean over cells follows from the mean components only
    where none of them was null. Where nothing in the file tells of an audit, all cells count as
    admitted.

    Args:
        path: with a header naming COLUMNS in any order, case and spelling of their underscores,
            and any of OPTIONAL_COLUMNS and OWN_COLUMNS; separated by comma, semicolon or tab.
            Without scenario and domain every line is a macro row. Lines that begin with ``#`` are
            notes.
        tell: called with what was left aside, a sentence each.

    Raises:
        InputError: it can't be read, a column is missing or doubled, a value is wrong, a cell
            stands twice, cells and macro rows are mixed, or facts of a model contradict each
            other; with line and column.
    """
    found: dict[tuple[str, ...], int] = {}
    facts: dict[str, tuple[int, CellRow]] = {}
    rows: list[CellRow] = []
    others: list[tuple[float, int, str]] = []
    for place, fields in _records(_text(path), path, tell):
        row = parse_row(place, fields)
        line = place.line or 0
        if rows and row.over != rows[0].over:
            raise place.error(
                f"is {_kind(row)}, and the lines before are {_kind(rows[0])}",
                remedy="analyse them apart: what is averaged already can't be averaged with cells",
            )
        key = (*row.key, row.run, "" if row.seed is None else str(row.seed))
        if key in found:
            raise place.error(
                f"cell {' / '.join(filter(None, key))} stands in line {found[key]} already",
                remedy="give each cell once, or tell its runs apart in a column run or seed",
            )
        found[key] = line
        first_line, first = facts.setdefault(row.model, (line, row))
        for name in _FACTS:
            if getattr(row, name) != getattr(first, name):
                raise place.at(name).error(
                    f"differs for {row.model} from line {first_line}",
                    fields.get(name, ""),
                    "a model has one value in all its lines",
                )
        given = parse_ivcs(place.at(_COMPUTED), fields.get(_COMPUTED, ""))
        if given is not None and row.ivcs is not None:
            apart = abs(given.value - row.ivcs)
            if apart > given.unit:
                others.append((apart, line, f"{given.value:g} there, {row.ivcs:.4f} computed"))
            if row.over and given.value != row.ivcs:
                row = replace(row, weighted=given.value)
        rows.append(row)
    if not rows:
        raise InputError("holds no cells", file=path, remedy="give one line per cell")
    for name in ("scenario", "model"):
        for one, other in _spellings([getattr(row, name) for row in rows]):
            tell(
                f"{path}: {name}s {one!r} and {other!r} are taken for two; write them alike if "
                "they are one."
            )
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
    return rows


def _kind(row: CellRow) -> str:
    return f"a mean over {'s and '.join(sorted(row.over))}s" if row.over else "a cell"


def _spellings(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of names that differ in case, and in what stands between their words, alone."""
    first: dict[str, str] = {}
    pairs = []
    for name in dict.fromkeys(names):
        other = first.setdefault(re.sub(r"[\s_-]+", " ", name.casefold()), name)
        if other != name:
            pairs.append((other, name))
    return pairs


def _text(path: Path) -> str:
    """What the file holds, without a byte order mark."""
    try:
        return read_text(path).removeprefix("\ufeff")
    except InputError as error:
        if not isinstance(error.__cause__, UnicodeDecodeError):
            raise
        remedy = "save it as CSV in UTF-8, which spreadsheets offer beside their own formats"
        raise InputError(error.problem, file=path, remedy=remedy) from error


def _records(text: str, path: Path, tell: Tell) -> Iterator[tuple[Place, Mapping[str, str]]]:
    """Place and fields by column of each line that is neither empty nor a note."""
    head = next((line for line in text.split("\n") if line.strip() and not _is_note(line)), "")
    delimiter = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    names: list[str] | None = None
    while True:
        place = Place(path, reader.line_num + 1)  # where a row begins, whatever lines it spans
        try:
            row = next(reader, None)
        except csv.Error as error:
            raise place.error(
                f"is no CSV: {error}", remedy='close every double quote; write one in a field as ""'
            ) from error
        if row is None:
            break
        row = [field.strip() for field in row]
        if not any(row) or (_is_note(row[0]) and (names is None or len(row) != len(names))):
            continue
        if names is None:
            names = _checked_names(row, place, tell)
        elif len(row) != len(names):
            commas = "; write decimals with a point, 0.5 and not 0,5" if delimiter == "," else ""
            raise place.error(
                f"has {len(row)} fields, the header has {len(names)}",
                remedy=f'put a field that holds the separator in double quotes ("){commas}',
            )
        else:
            yield place, dict.fromkeys(_OF_CELLS, MACRO) | dict(zip(names, row, strict=True))
    if names is None:
        raise Place(path, 1).error("is empty", remedy=f"begin with {','.join(COLUMNS)}")


def _is_note(text: str) -> bool:
    return text.lstrip().lstrip('"').startswith("#")


def _plain(name: str) -> str:
    """A column's name without case, spaces and underscores."""
    return re.sub(r"[^a-z0-9]", "", name.casefold())


_BY_PLAIN = {_plain(name): name for name in _READ}


def _checked_names(given: list[str], place: Place, tell: Tell) -> list[str]:
    """The columns by the names that we know; those that aren't known stay as they are."""
    names = [_BY_PLAIN.get(_plain(name), name) for name in given]
    for name, written in zip(names, given, strict=True):
        if name in _READ and names.count(name) > 1:
            raise place.error("has a column twice", written, "name each column once")
    needed = [name for name in COLUMNS if name != "risk" or "rsr" not in names]
    if "rsr" in names and not set(_OF_CELLS) & set(names):
        needed = [name for name in needed if name not in _OF_CELLS]
        tell(
            f"{place.file}: has no columns scenario and domain: each line is taken for a mean over "
            "all of them."
        )
    if missing := [name for name in needed if name not in names]:
        likely = [
            f"call {written!r} {wanted} if it is that"
            for written in given
            if (wanted := _LIKELY.get(_plain(written))) in missing
        ]
        raise place.error(
            f"misses the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
            remedy="; ".join(
                ["an empty field stands for null, but the column must be there", *likely]
            ),
        )
    ignored = [name for name in names if name not in _READ and name != _REMARK]
    if "risk" in names:
        ignored += [name for name in ("rsr", "rl_s") if name in names]
    if ignored:
        shown = ", ".join(name or "one without a name" for name in ignored)
        tell(f"{place.file}: columns that are ignored: {shown}. Known are {', '.join(_READ[:-1])}.")
    return names
