"""Where rows come from: the folder of a campaign, or a CSV file of component scores."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import read_text
from ssp_core.vocab import DOMAINS
from ssp_eval.analysis.row import CellRow
from ssp_eval.evaluate.admission import ADMITTED
from ssp_eval.evaluate.controls import is_control_name
from ssp_eval.report.load import CellData, load_cells
from ssp_eval.score.show import NULL
from ssp_eval.strict import Place

__all__ = ["CellRow", "rows_from_campaign", "rows_from_cells", "rows_from_csv"]

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
# Their denominator is the number of labels, which is never 0; without them there is no IVCS.
_NEVER_NULL = ("jovr", "tqsr")
_RESPONSE = re.compile(r"S@(\d+(?:\.\d+)?)", re.ASCII)
_DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_SEED = re.compile(r"\d{1,18}", re.ASCII)
_FACTS = ("total_b", "active_b", "architecture")


def rows_from_campaign(out: Path, run: str = "") -> list[CellRow]:
    """All cells of a campaign, scored again from their records; refused and failed ones too.

    Args:
        out: campaign folder.
        run: name of the repetition, where several campaigns are taken together.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    return rows_from_cells(load_cells(out), run)


def rows_from_cells(cells: list[CellData], run: str = "") -> list[CellRow]:
    """The rows of cells that were loaded already; see rows_from_campaign."""
    return [_row_of(cell, run) for cell in cells]


def _row_of(cell: CellData, run: str) -> CellRow:
    facts, score = cell.facts.model_facts, cell.score

    def value(name: str) -> float | None:
        return None if score is None else getattr(score, name)

    return CellRow(
        scenario=cell.scenario,
        domain=cell.domain,
        model=cell.model,
        jovr=value("jovr"),
        sem_acc_eff=value("sem_acc_eff"),
        cia_eff=value("cia_eff"),
        act_acc_eff=value("act_acc_eff"),
        tqsr=value("tqsr"),
        atc_eff=value("atc_eff"),
        rsr=value("rsr"),
        rl_s=value("rl_s"),
        sem_cov=value("sem_cov"),
        stfr=value("stfr"),
        sem_acc_cond=value("sem_acc_cond"),
        sem_acc_soft=value("sem_acc_soft"),
        n=len(cell.labels.labels),
        run=run,
        total_b=facts.total_b,
        active_b=facts.active_b,
        architecture=facts.architecture,
        control=cell.is_control,
        admitted=cell.admission == ADMITTED,
        status=cell.facts.status,
        reason="; ".join(cell.facts.reasons),
    )


def rows_from_csv(path: Path) -> list[CellRow]:
    """The cells of a CSV file of component scores; IVCS is computed (METHOD 6.10).

    Nothing in it tells of an audit, so all cells count as admitted.

    Args:
        path: with a header naming COLUMNS and any of OPTIONAL_COLUMNS in any order; separated by
            comma, semicolon or tab. Null stands as an empty field or as ``–``.

    Raises:
        InputError: it can't be read, a column is missing, unknown or doubled, a value is wrong, a
            cell stands twice, or facts of a model contradict each other; with line and column.
    """
    found: dict[tuple[str, ...], int] = {}
    facts: dict[str, tuple[int, CellRow]] = {}
    rows = []
    for place, fields in _records(read_text(path).removeprefix("\ufeff"), path):
        row = _parse(place, fields)
        line = place.line or 0
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
        rows.append(row)
    if not rows:
        raise InputError("holds no cells", file=path, remedy="give one line per cell")
    return rows


def _records(text: str, path: Path) -> Iterator[tuple[Place, Mapping[str, str]]]:
    """Place and fields by column of each line that isn't empty."""
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    names: list[str] | None = None
    while True:
        place = Place(path, reader.line_num + 1)  # where a row begins, whatever lines it spans
        try:
            row = next(reader, None)
        except csv.Error as error:
            raise place.error(f"is no CSV: {error}") from error
        if row is None:
            break
        row = [field.strip() for field in row]
        if not any(row):
            continue
        if names is None:
            names = _checked_names(row, place)
        elif len(row) != len(names):
            raise place.error(
                f"has {len(row)} fields, the header has {len(names)}",
                remedy='put a field that holds the separator in double quotes (")',
            )
        else:
            yield place, dict(zip(names, row, strict=True))
    if names is None:
        raise Place(path, 1).error("is empty", remedy=f"begin with {','.join(COLUMNS)}")


def _checked_names(names: list[str], place: Place) -> list[str]:
    known = (*COLUMNS, *OPTIONAL_COLUMNS)
    for name in names:
        if name not in known:
            raise place.error(
                "has a column that is not known", name, f"known are {', '.join(known)}"
            )
        if names.count(name) > 1:
            raise place.error("has a column twice", name, "name each column once")
    if missing := [name for name in COLUMNS if name not in names]:
        raise place.error(
            f"misses the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
            remedy="an empty field stands for null, but the column must be there",
        )
    return names


def _parse(place: Place, fields: Mapping[str, str]) -> CellRow:
    def read(name: str, parser: Callable[[Place, str], float | None]) -> float | None:
        return parser(place.at(name), fields.get(name, ""))

    for name in ("scenario", "domain", "model"):
        if not fields[name]:
            raise place.at(name).error("is empty", remedy="name it")
    if fields["domain"] not in DOMAINS:
        raise place.at("domain").error(
            "is no domain", fields["domain"], f"known are {', '.join(DOMAINS)}"
        )
    for name in _NEVER_NULL:
        if fields[name] in ("", NULL):
            raise place.at(name).error(
                "is never null: its denominator is the number of labels", fields[name], "give it"
            )
    rsr, rl_s = _risk(place.at("risk"), fields["risk"])
    total_b, active_b = read("total_b", _billions), read("active_b", _billions)
    if total_b is not None and active_b is not None and active_b > total_b:
        raise place.at("active_b").error(
            "is more than total_b", fields["active_b"], f"at most {fields['total_b']}"
        )
    seed = fields.get("seed", "")
    if seed and not _SEED.fullmatch(seed):
        raise place.at("seed").error("is no whole number", seed, "give 0 or a positive number")
    return CellRow(
        scenario=fields["scenario"],
        domain=fields["domain"],
        model=fields["model"],
        jovr=read("jovr", _share),
        sem_acc_eff=read("sem_acc_eff", _share),
        cia_eff=read("cia_eff", _share),
        act_acc_eff=read("act_acc_eff", _share),
        tqsr=read("tqsr", _share),
        atc_eff=read("atc_eff", _share),
        rsr=rsr,
        rl_s=rl_s,
        sem_cov=read("sem_cov", _share),
        run=fields.get("run", ""),
        seed=int(seed) if seed else None,
        total_b=total_b,
        active_b=active_b,
        architecture=fields.get("architecture", ""),
        control=is_control_name(fields["model"]),
    )


def _number(place: Place, text: str, remedy: str) -> float:
    value = float(text) if _DECIMAL.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise place.error("is no number", text, remedy)
    return value


def _share(place: Place, text: str) -> float | None:
    if text in ("", NULL):
        return None
    value = _number(place, text, f"give 0 to 1 with a decimal point, or {NULL} for null")
    if not 0.0 <= value <= 1.0:
        raise place.error("is outside 0 to 1", text, "give it as a share, 0.5 instead of 50")
    return value


def _billions(place: Place, text: str) -> float | None:
    if text in ("", NULL):
        return None
    value = _number(place, text, "give billions of parameters, or nothing")
    if value <= 0.0:
        raise place.error("must be positive", text, "give billions of parameters, or nothing")
    return value


def _risk(place: Place, text: str) -> tuple[int, float | None]:
    if text == "F":
        return 0, None
    found = _RESPONSE.fullmatch(text)
    if found is None:
        raise place.error(
            "is no risk response", text, "write S@1.50 for one after 1.50 s, or F for none"
        )
    return 1, _number(place, found[1], "write the latency in seconds")
