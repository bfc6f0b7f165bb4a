"""Puts the page together: data, figures, pictures, template, style and script in one file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jinja2
from markupsafe import Markup

from ssp_core import __version__
from ssp_core.files import make_folder, write_text
from ssp_core.hashing import sha256_file
from ssp_eval.audit.model import AUDIT_FILE
from ssp_eval.audit.model import PAGE_FILE as AUDIT_PAGE
from ssp_eval.evaluate.admission import ADMITTED
from ssp_eval.evaluate.cell_file import frame_path
from ssp_eval.report.load import CellData, load_cells
from ssp_eval.report.matrix import matrix
from ssp_eval.report.pictures import data_uri
from ssp_eval.report.tables import (
    MEAN_COLUMNS,
    STAGE_NAMES,
    failure_rows,
    mean_tables,
    rank_tables,
    scored,
)
from ssp_eval.report.view import RecordView, record_views, tolerated

PAGE = "index.html"
# Where a campaign keeps its audits, if it does.
AUDIT_PATTERN = f"audits/*/{AUDIT_FILE}"
_HERE = Path(__file__).parent
SLOTS = ("objects", "position", "motion", "conflict", "lon_action", "lat_action")


def write_report(out: Path, on_picture: Callable[[int, int], None] = lambda done, of: None) -> Path:
    """Writes ``index.html`` into a campaign folder.

    Args:
        out: campaign folder.
        on_picture: told how many pictures are done, and of how many.

    Returns:
        The file.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    cells = load_cells(out)
    views = {cell.id: record_views(cell) for cell in cells}
    used = sorted({v.frame for of_cell in views.values() for v in of_cell if v.frame is not None})
    pictures: dict[str, str] = {}
    for done, frame in enumerate(used, start=1):
        path = frame_path(out, frame)
        if path.exists():
            pictures[frame] = data_uri(path)
        on_picture(done, len(used))
    target = make_folder(out) / PAGE
    write_text(target, render(cells, views, pictures, audit_pages(out, cells)))
    return target


def audit_pages(out: Path, cells: list[CellData]) -> dict[str, str]:
    """Pages of the audits that the cells go by, where they lie in the campaign folder.

    Returns:
        Path from the report by hash of the audit, those of the first scenario first.
    """
    found = {}
    named = dict.fromkeys(cell.audit_sha256 for cell in cells)
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
) -> str:
    """The page as HTML.

    Args:
        cells: in the order in which they are shown.
        views: by cell id, its label times.
        pictures: data URIs by frame hash.
        audits: path of an audit's page by the audit's hash.
    """
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
    environment.filters["json"] = lambda value: json.dumps(value, sort_keys=True)
    entering = scored(cells)
    template = environment.get_template("page.html.j2")
    return template.render(
        cells=cells,
        views=views,
        pictures=Markup(_script_json(pictures)),
        audits=audits,
        audit_links=_audit_links(cells, audits),
        style=Markup((_HERE / "style.css").read_text("utf-8")),
        script=Markup((_HERE / "page.js").read_text("utf-8")),
        matrix=Markup(matrix(cells)),
        means=mean_tables(entering),
        mean_columns=MEAN_COLUMNS,
        ranks=rank_tables(entering) if entering else [],
        failures=failure_rows(cells),
        stages=STAGE_NAMES,
        slots=SLOTS,
        tolerated={cell.id: tolerated(cell) for cell in cells},
        facts=_facts(cells, views),
        version=__version__,
    )


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
    """JSON that can stand in a script element."""
    return json.dumps(value, sort_keys=True).replace("</", "<\\/")


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
    return [(status, ", ".join(sorted(names))) for status, names in sorted(found.items())]


def _facts(cells: list[CellData], views: dict[str, list[RecordView]]) -> dict[str, Any]:
    ok = [cell for cell in cells if cell.score is not None]
    driven = list(dict.fromkeys(c.model for c in cells if not c.is_control))
    scenarios = sorted({cell.scenario for cell in cells})
    return {
        "title": _title(driven, scenarios),
        "scenarios": scenarios,
        "domains": list(dict.fromkeys(cell.domain for cell in cells)),
        "models": list(dict.fromkeys(cell.model for cell in cells)),
        "driven": len(driven),
        "records": sum(len(of_cell) for of_cell in views.values()),
        "scored": len(ok),
        "out": [cell for cell in cells if cell.score is None],
        "outside": _outside(cells),
        "stand_in": sorted({f"{c.scenario} / {c.domain}" for c in cells if c.facts.stand_in}),
        "proposed": any(cell.facts.labels_proposed for cell in cells),
        "controls": sorted({cell.model for cell in cells if cell.is_control}),
        "nulls": [cell for cell in ok if cell.score and cell.score.details.ivcs_nulls],
        "unmatched": [cell for cell in ok if cell.score and cell.score.details.unmatched_records],
        "notes": [cell for cell in cells if cell.notes],
        "assumed": sorted(
            {
                f"{c.scenario} / {c.domain}: ego motion {c.facts.clip.ego}, camera "
                f"{c.facts.clip.camera}"
                for c in cells
                if (c.facts.clip.ego, c.facts.clip.camera) != ("measured", "measured")
            }
        ),
        "missing": sum(len(cell.facts.answers.missing) for cell in ok),
    }
