"""Component scores from a CSV file: a matrix that was published, or the ``matrix.csv`` of ours."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import read_text
from ssp_core.vocabulary import DOMAINS_READ, read_domain
from ssp_eval.data.json_fields import Location
from ssp_eval.evaluate.models import is_control_name
from ssp_eval.score.cli import NULL
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.rows import MACRO, OK, CellRow
from ssp_eval.statistics.tables import NO, YES

# Null as tables write it: nothing, or a dash of any length.
_NULLS = ("", NULL, "—", "-", "−")
# Their denominator is the number of labels, which is never 0; without them there is no IVCS.
_NEVER_NULL = ("jovr", "tqsr")
_SCORES = (
    "jovr", "sem_acc_eff", "cia_eff", "act_acc_eff", "tqsr", "atc_eff", "sem_cov", "sem_acc_cond",
    "sem_acc_soft", "stfr",
)  # fmt: skip
_STATES = (OK, "refused", "failed")
_RESPONSE = re.compile(r"S@(\d+(?:\.\d+)?)", re.ASCII)
_DECIMAL = re.compile(r"[+-]?(\d+\.?(\d*)|\.(\d+))([eE][+-]?\d+)?", re.ASCII)
_COMMA = re.compile(r"[+-]?\d*,\d+", re.ASCII)
_SHA256 = re.compile(r"sha256:[0-9a-f]{64}")
_WHOLE = re.compile(r"\d{1,18}", re.ASCII)
# A text that a spreadsheet would take for a formula is written with this before it.
_GUARDED = re.compile(r"'[=+\-@\t\r]")


@dataclass(frozen=True)
class Given:
    """A number as it stands in a file: its value, and one unit of its last digit."""

    value: float
    unit: float


def parse_row(place: Location, fields: Mapping[str, str]) -> CellRow:
    """One line as a row.

    Args:
        place: of the line.
        fields: by the names of cells_csv, stripped.

    Raises:
        InputError: a value is wrong; with its column.
    """

    def text(name: str) -> str:
        found = fields.get(name, "")
        return found[1:] if _GUARDED.match(found) else found

    for name in ("scenario", "domain", "model"):
        if not fields[name]:
            raise place.at(name).error("is empty", remedy="name it")
    is_macro = [fields[name].casefold() == MACRO for name in ("scenario", "domain")]
    domain = MACRO if is_macro[1] else read_domain(fields["domain"])
    if domain is None:
        remedy = f"known are {DOMAINS_READ}, and {MACRO} for a published mean over them"
        raise place.at("domain").error("is no domain", fields["domain"], remedy)
    status = fields.get("status", "").casefold() or OK
    if status not in _STATES:
        raise place.at("status").error(
            "is no state of a cell", fields["status"], f"known are {', '.join(_STATES)}"
        )
    scores = {name: _share(place.at(name), fields.get(name, "")) for name in _SCORES}
    rsr, rl_s = (_macro_risk if any(is_macro) else _risk_of)(place, fields)
    _check_status(place, status, fields, {**scores, "rsr": rsr, "rl_s": rl_s})
    total_b, active_b = (
        _billions(place.at(name), fields.get(name, "")) for name in ("total_b", "active_b")
    )
    if total_b is not None and active_b is not None and active_b > total_b:
        raise place.at("active_b").error(
            "is more than total_b", fields["active_b"], f"at most {fields['total_b']}"
        )
    return CellRow(
        scenario=MACRO if is_macro[0] else text("scenario"),
        domain=domain,
        model=text("model"),
        **scores,
        rsr=rsr,
        rl_s=rl_s,
        n=_whole(place.at("n"), fields.get("n", ""), 1),
        run=text("run"),
        seed=_whole(place.at("seed"), fields.get("seed", ""), 0),
        total_b=total_b,
        active_b=active_b,
        architecture="" if text("architecture") in _NULLS else text("architecture"),
        control=is_control_name(text("model")) or _flag(place, fields, "control", NO),
        admitted=_flag(place, fields, "admitted", YES),
        stand_in=_flag(place, fields, "stand_in", NO),
        status=status,
        reason=text("reason"),
        thresholds=_hash(place.at("thresholds"), fields.get("thresholds", "")),
    )


def parse_ivcs(place: Location, field: str) -> Given | None:
    """What a file says IVCS is; None where it says nothing.

    Raises:
        InputError: it is no share.
    """
    value = _share(place, field)
    digits = _DECIMAL.fullmatch(field)
    if value is None or digits is None:
        return None
    shown = len(digits[2] or digits[3] or "")
    return Given(value, max(1e-9, 0.0 if digits[4] else 10.0**-shown))


def _check_status(
    place: Location, status: str, fields: Mapping[str, str], found: Mapping[str, float | None]
) -> None:
    if status == OK:
        for name in _NEVER_NULL:
            if found[name] is None:
                raise place.at(name).error(
                    "is never null: its denominator is the number of labels",
                    fields[name],
                    "give it, or leave the line out where the cell has no scores",
                )
        return
    for name, value in found.items():
        if value is not None:
            raise place.at(name).error(
                f"stands in a cell that is {status}, which has no scores",
                fields.get(name),
                f"leave it empty, or give {OK} as status",
            )


def _number(place: Location, text: str, remedy: str) -> float:
    digits = text.removesuffix("%").rstrip()
    if text.endswith("%") and _DECIMAL.fullmatch(digits):
        share = f"{float(digits) / 100:.6g}"
        raise place.error("is a percentage", text, f"write it as a share, {share}")
    if _COMMA.fullmatch(digits):
        point = digits.replace(",", ".")
        raise place.error("has a decimal comma", text, f"write it with a point, {point}")
    value = float(text) if _DECIMAL.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise place.error("is no number", text, remedy)
    return value


def _share(place: Location, text: str) -> float | None:
    if text in _NULLS:
        return None
    value = _number(place, text, f"give 0 to 1 with a decimal point, or {NULL} for null")
    if not 0.0 <= value <= 1.0:
        example = f"{value / 100:g} instead of {text}" if 1 < value <= 100 else "0.5 instead of 50"
        raise place.error("is outside 0 to 1", text, f"give it as a share, {example}")
    return value


def _billions(place: Location, text: str) -> float | None:
    if text in _NULLS:
        return None
    remedy = "give billions of parameters as a plain number, 7 for 7B, or nothing"
    value = _number(place, text, remedy)
    if value <= 0.0:
        raise place.error("must be positive", text, remedy)
    return value


def _whole(place: Location, text: str, least: int) -> int | None:
    if text in _NULLS:
        return None
    if not _WHOLE.fullmatch(text) or int(text) < least:
        raise place.error("is no whole number", text, f"give {least} or more, or nothing")
    return int(text)


def _hash(place: Location, text: str) -> str:
    if text and not _SHA256.fullmatch(text):
        remedy = "give sha256:<64 hex digits> of the scorer's thresholds, nothing for METHOD's"
        raise place.error("is no hash", text, remedy)
    return "" if text == DEFAULT.sha256 else text


def _flag(place: Location, fields: Mapping[str, str], name: str, usual: str) -> bool:
    text = fields.get(name, "").casefold() or usual
    if text not in (YES, NO):
        raise place.at(name).error("is neither yes nor no", fields[name], f"write {YES} or {NO}")
    return text == YES


def _risk_of(place: Location, fields: Mapping[str, str]) -> tuple[float | None, float | None]:
    """RSR and RL: of ``risk``, or where there is no such column of rsr and rl_s."""
    if "risk" in fields:
        return _risk(place.at("risk"), fields["risk"])
    text = fields["rsr"]
    if text in _NULLS:
        return None, None
    if _number(place.at("rsr"), text, "write 1 or 0") not in (0.0, 1.0):
        raise place.at("rsr").error(
            "is neither 1 nor 0",
            text,
            f"give each run of a cell a line of its own; of a mean over cells, write {MACRO} as "
            "its scenario, domain or both",
        )
    if float(text) == 0.0:
        return 0, None
    rl_s = _latency(place, fields)
    if rl_s is None:
        raise place.at("rl_s").error(
            "is missing for a response", remedy="give its latency in seconds"
        )
    return 1, rl_s


def _macro_risk(place: Location, fields: Mapping[str, str]) -> tuple[float | None, float | None]:
    """RSR of a macro row, the share of cells with a response, and the mean RL over these."""
    if "risk" in fields:
        raise place.at("risk").error(
            "is the response of a single cell, and this is a macro row",
            fields["risk"],
            "replace the column by rsr, the share of cells with a response (0 to 1), and rl_s, "
            "their mean latency in seconds, which may be empty",
        )
    rsr, rl_s = _share(place.at("rsr"), fields["rsr"]), _latency(place, fields)
    if rl_s is not None and not rsr:
        raise place.at("rl_s").error(
            "is given where no cell has a response", fields["rl_s"], "leave it empty"
        )
    return rsr, rl_s


def _latency(place: Location, fields: Mapping[str, str]) -> float | None:
    text = fields.get("rl_s", "")
    if text in _NULLS:
        return None
    value = _number(place.at("rl_s"), text, "write the latency in seconds")
    if value < 0.0:
        raise place.at("rl_s").error("is negative", text, "write the latency in seconds")
    return value


def _risk(place: Location, text: str) -> tuple[float | None, float | None]:
    if text in _NULLS:
        return None, None
    if text == "F":
        return 0, None
    found = _RESPONSE.fullmatch(text)
    if found is None:
        comma = re.fullmatch(r"S@\d+,\d+", text, re.ASCII)
        remedy = "write S@1.50 for one after 1.50 s, F for none"
        if comma:
            remedy = f"write it with a point, {text.replace(',', '.')}"
        raise place.error("is no risk response", text, remedy)
    return 1, _number(place, found[1], "write the latency in seconds")


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


def _records(text: str, path: Path, tell: Tell) -> Iterator[tuple[Location, Mapping[str, str]]]:
    """Place and fields by column of each line that is neither empty nor a note."""
    head = next((line for line in text.split("\n") if line.strip() and not _is_note(line)), "")
    delimiter = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    names: list[str] | None = None
    while True:
        place = Location(path, reader.line_num + 1)  # where a row begins, whatever lines it spans
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
        raise Location(path, 1).error("is empty", remedy=f"begin with {','.join(COLUMNS)}")


def _is_note(text: str) -> bool:
    return text.lstrip().lstrip('"').startswith("#")


def _plain(name: str) -> str:
    """A column's name without case, spaces and underscores."""
    return re.sub(r"[^a-z0-9]", "", name.casefold())


_BY_PLAIN = {_plain(name): name for name in _READ}


def _checked_names(given: list[str], place: Location, tell: Tell) -> list[str]:
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
