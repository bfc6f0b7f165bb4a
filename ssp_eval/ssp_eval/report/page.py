"""Puts the page together: one file with its pictures, or a large one with files beside it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jinja2
from markupsafe import Markup

from ssp_core import __version__
from ssp_core.files import make_folder, write_text
from ssp_core.hashing import sha256_file
from ssp_eval.analysis.sections import page_parts
from ssp_eval.analysis.table import Table
from ssp_eval.audit.model import AUDIT_FILE
from ssp_eval.audit.model import PAGE_FILE as AUDIT_PAGE
from ssp_eval.evaluate.admission import ADMITTED
from ssp_eval.evaluate.cell_file import frame_path
from ssp_eval.report.blinded import COLUMNS as BLINDED_COLUMNS
from ssp_eval.report.blinded import blinded_rows, control_cells
from ssp_eval.report.facts import CellFacts, load_facts
from ssp_eval.report.large import DetailFiles, load_lightly, rows
from ssp_eval.report.load import CellData, cell_files, in_order, load_cell
from ssp_eval.report.matrix import matrix
from ssp_eval.report.pictures import data_uri
from ssp_eval.report.tables import (
    MEAN_COLUMNS,
    STAGE_NAMES,
    failure_rows,
    failures_by_model,
    mean_rows,
    mean_tables,
    rank_tables,
    scored,
)
from ssp_eval.report.view import RecordView, record_views, tolerated
from ssp_eval.score.aggregate import BY_MODEL
from ssp_eval.score.show import NULL

PAGE = "index.html"
# Where a campaign keeps its audits, if it does.
AUDIT_PATTERN = f"audits/*/{AUDIT_FILE}"
# Up to here a page holds all details and pictures; beyond, a browser would choke on them.
MOST_IN_ONE_FILE = 24
# Notices of single cells, and names of missing ones, that a page shows before it only counts.
_MOST_NOTICES = 12
_HERE = Path(__file__).parent
SLOTS = ("objects", "position", "motion", "conflict", "lon_action", "lat_action")


def write_report(
    out: Path,
    on_step: Callable[[int, int], None] = lambda done, of: None,
    most: int | None = None,
    analysis: Sequence[Table] = (),
) -> Path:
    """Writes ``index.html`` into a campaign folder, and for a large one files beside it.

    Args:
        out: campaign folder.
        on_step: told how many pictures or cells are done, and of how many.
        most: cells up to which everything goes into the one file; None: MOST_IN_ONE_FILE.
        analysis: statistics to show.

    Returns:
        The page.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    files = cell_files(out)
    if len(files) <= (MOST_IN_ONE_FILE if most is None else most):
        cells = in_order(load_cell(file) for file in files)
        return _write_one(out, cells, on_step, analysis)
    return _write_large(out, files, on_step, analysis)


def _write_one(
    out: Path,
    cells: list[CellData],
    on_step: Callable[[int, int], None],
    analysis: Sequence[Table],
) -> Path:
    views = {cell.id: record_views(cell) for cell in cells}
    used = sorted({v.frame for of_cell in views.values() for v in of_cell if v.frame is not None})
    pictures: dict[str, str] = {}
    for done, frame in enumerate(used, start=1):
        path = frame_path(out, frame)
        if path.exists():
            pictures[frame] = data_uri(path)
        on_step(done, len(used))
    target = make_folder(out) / PAGE
    audits = audit_pages(out, (cell.facts for cell in cells))
    write_text(target, render(cells, views, pictures, audits, analysis))
    return target


def _write_large(
    out: Path,
    files: list[Path],
    on_step: Callable[[int, int], None],
    analysis: Sequence[Table],
) -> Path:
    """Details of one cell after the other, so that memory holds one cell's pictures of words."""
    audits = audit_pages(out, (load_facts(file) for file in files))
    details = DetailFiles(out, _environment(), audits)
    done = count(1)

    def write(cell: CellData) -> None:
        details.write(cell)
        on_step(next(done), len(files))

    cells = in_order(load_lightly(files, write))
    target = make_folder(out) / PAGE
    write_text(target, render_large(cells, audits, analysis))
    details.remove_others()
    return target


def audit_pages(out: Path, cells: Iterable[CellFacts]) -> dict[str, str]:
    """Pages of the audits that the cells go by, where they lie in the campaign folder.

    Returns:
        Path from the report by hash of the audit, those of the first scenario first.
    """
    found = {}
    named = dict.fromkeys(cell.admission.audit_sha256 for cell in cells)
    there = {
        sha256_file(file): file.with_name(AUDIT_PAGE) for file in sorted(out.glob(AUDIT_PATTERN))
    }
    for digest in named:
        if digest is not None and digest in there and there[digest].is_file():
            found[digest] = there[digest].relative_to(out).as_posix()
    return found


def render(
    cells: list[CellData],
    views: dict[str, list[RecordView]],
    pictures: dict[str, str],
    audits: Mapping[str, str] = MappingProxyType({}),
    analysis: Sequence[Table] = (),
) -> str:
    """The page as HTML.

    Args:
        cells: in the order in which they are shown.
        views: by cell id, its label times.
        pictures: data URIs by frame hash.
        audits: path of an audit's page by the audit's hash.
        analysis: statistics to show.
    """
    drawn = {
        "views": views,
        "tolerated": {cell.id: tolerated(cell) for cell in cells},
        "matrix": Markup(matrix(cells)),
        "failures": failure_rows(cells),
        "data": Markup(_script_json(pictures)),
        "script": _source("page.js"),
    }
    return _page(cells, audits, browse=False, analysis=page_parts(analysis), **drawn)


def render_large(
    cells: list[CellData],
    audits: Mapping[str, str] = MappingProxyType({}),
    analysis: Sequence[Table] = (),
) -> str:
    """The page of a large campaign as HTML; details lie in files beside it.

    Args:
        cells: in the order in which they are shown; without records and questions.
        audits: path of an audit's page by the audit's hash.
        analysis: statistics to show.
    """
    drawn = {
        "failures_by_model": failures_by_model(cells),
        "data": Markup(_script_json(rows(cells))),
        "script": _source("browse.js"),
    }
    return _page(cells, audits, browse=True, analysis=page_parts(analysis), **drawn)


def _page(cells: list[CellData], audits: Mapping[str, str], **drawn: Any) -> str:
    entering, controls = scored(cells), control_cells(cells)
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            cells=cells,
            audits=audits,
            audit_links=_audit_links(cells, audits),
            style=_source("style.css"),
            means=mean_tables(entering),
            mean_columns=MEAN_COLUMNS,
            ranks=rank_tables(entering) if entering else [],
            blinded=blinded_rows(cells),
            blinded_columns=BLINDED_COLUMNS,
            controls=mean_rows(controls, BY_MODEL),
            stages=STAGE_NAMES,
            slots=SLOTS,
            facts=_facts(cells),
            most=_MOST_NOTICES,
            version=__version__,
            **drawn,
        )
    )


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = Markup
    environment.filters["words"] = lambda text: str(text).replace("_", " ")
    environment.filters["short"] = _short
    environment.filters["score"] = lambda value: NULL if value is None else f"{value:.3f}"
    environment.filters["json"] = lambda value: json.dumps(value, sort_keys=True)
    return environment


def _source(name: str) -> Markup:
    return Markup((_HERE / name).read_text("utf-8"))


def _audit_links(cells: list[CellData], audits: Mapping[str, str]) -> list[tuple[str, str]]:
    """Scenario and page of each audit."""
    found: dict[str, str] = {}
    for cell in cells:
        page = audits.get(cell.audit_sha256 or "")
        if page is not None:
            found.setdefault(cell.scenario, page)
    return list(found.items())


def _short(digest: str) -> str:
    return digest.removeprefix("sha256:")[:12]


def _script_json(value: Any) -> str:
    """JSON that can stand in a script element, whatever its texts hold.

    A text could end the element, or open a comment and a script in it, so that its end isn't seen.
    """
    return json.dumps(value, sort_keys=True).replace("<", "\\u003c")


def _title(models: list[str], scenarios: list[str]) -> str:
    """Who was evaluated on what, in words; counts where there are many."""

    def listed(names: list[str], many: str) -> str:
        words = [name.replace("_", " ") for name in names]
        return " and ".join(words) if 0 < len(words) <= 2 else f"{len(words)} {many}"

    title = f"{listed(models, 'models')} on {listed(scenarios, 'scenarios')}"
    return title[0].upper() + title[1:]


def _outside(cells: list[CellData]) -> list[tuple[str, str]]:
    """Scored recordings that stay out of domain means, by what the audit says of them."""
    found: dict[str, set[str]] = {}
    for cell in cells:
        if cell.score is not None and cell.admission != ADMITTED:
            found.setdefault(cell.admission, set()).add(f"{cell.scenario} / {cell.domain}")
    return [(status, _some(sorted(names))) for status, names in sorted(found.items())]


def _some(names: list[str], separator: str = ", ") -> str:
    """The first of many names, and how many more there are."""
    shown = separator.join(names[:_MOST_NOTICES])
    more = len(names) - _MOST_NOTICES
    return f"{shown}{separator}and {more} more" if more > 0 else shown


def _absent(cells: list[CellData]) -> list[str]:
    """Models that weren't asked about a recording that another was asked about.

    A condition is a control of its own, and is given to all models or none.
    """
    there = {(cell.scenario, cell.domain, cell.model) for cell in cells}
    clips = dict.fromkeys((cell.scenario, cell.domain) for cell in cells)
    models = dict.fromkeys(cell.model for cell in cells)
    return [
        " / ".join((*clip, model)) for clip in clips for model in models
        if (*clip, model) not in there
    ]  # fmt: skip


def _mixed(cells: list[CellData]) -> str:
    """Recordings that were put in the place of others, or labels, when only some models had been
    asked again: their cells can't be compared."""
    found: dict[str, set[tuple[str | None, str | None]]] = {}
    for cell in cells:
        if cell.score is not None:
            told = cell.facts.hashes.get("bag"), cell.facts.hashes.get("labels")
            found.setdefault(f"{cell.scenario} / {cell.domain}", set()).add(told)
    return _some(sorted(name for name, told in found.items() if len(told) > 1))


def _facts(cells: list[CellData]) -> dict[str, Any]:
    ok = [cell for cell in cells if cell.score is not None]
    driven = list(dict.fromkeys(c.model for c in cells if not c.is_control))
    scenarios = sorted({cell.scenario for cell in cells})
    return {
        "title": _title(driven, scenarios),
        "scenarios": scenarios,
        "domains": list(dict.fromkeys(cell.domain for cell in cells)),
        "models": list(dict.fromkeys(cell.model for cell in cells)),
        "driven": len(driven),
        "records": sum(cell.score.n for cell in cells if cell.score is not None),
        "statuses": dict(sorted(Counter(c.facts.status for c in cells if not c.score).items())),
        "absent": _absent(cells),
        "admissions": sorted({cell.admission for cell in cells}),
        "scored": len(ok),
        "out": [cell for cell in cells if cell.score is None],
        "outside": _outside(cells),
        "mixed": _mixed(cells),
        "extractors": len({cell.facts.hashes.get("extractor") for cell in ok}),
        "stand_in": _some(
            sorted({f"{c.scenario} / {c.domain}" for c in cells if c.facts.stand_in})
        ),
        "proposed": any(cell.facts.labels_proposed for cell in cells),
        "controls": sorted({cell.model for cell in cells if cell.is_control}),
        "nulls": [cell for cell in ok if cell.score and cell.score.details.ivcs_nulls],
        "unmatched": [cell for cell in ok if cell.score and cell.score.details.unmatched_records],
        "notes": [cell for cell in cells if cell.notes],
        "assumed": _some(
            sorted(
                {
                    f"{c.scenario} / {c.domain}: ego motion {c.facts.clip.ego}, camera "
                    f"{c.facts.clip.camera}"
                    for c in cells
                    if (c.facts.clip.ego, c.facts.clip.camera) != ("measured", "measured")
                }
            ),
            "; ",
        ),
        "missing": sum(len(cell.facts.answers.missing) for cell in ok),
    }
