"""The page of a campaign as HTML, from its cells and the tables that are made of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jinja2
from markupsafe import Markup

from ssp_core import __version__
from ssp_eval.analysis.control_tables import ANSWERERS, SEEING
from ssp_eval.analysis.failure_table import STAGE_NAMES, failures_by_cell, failures_by_model
from ssp_eval.analysis.notices import notices
from ssp_eval.analysis.rows import rows_from_cells
from ssp_eval.analysis.sections import page_parts
from ssp_eval.analysis.table import Table
from ssp_eval.analysis.tables import MEAN_TABLES, all_tables
from ssp_eval.report.grid import common_notes, grid, rank_grids, without_notes
from ssp_eval.report.large import rows as browsed_rows
from ssp_eval.report.load import CellData
from ssp_eval.report.matrix import matrix
from ssp_eval.report.seeing import seeing_plot
from ssp_eval.report.summary import summary
from ssp_eval.report.view import RecordView, tolerated
from ssp_eval.templates import templates

SLOTS = ("objects", "position", "motion", "conflict", "lon_action", "lat_action")
# Means that a page shows folded: each has many rows, or is for those who look closer.
_FOLDED = ("by_scenario_model", "by_domain_model", "strata", "foundation_models")
# Notices that aren't about all cells, before a page only counts them.
MOST_NOTICES = 12
_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Details:
    """What a page that holds everything has behind each cell.

    Args:
        views: by cell id, its label times.
        pictures: data URIs by frame hash.
    """

    views: Mapping[str, Sequence[RecordView]]
    pictures: Mapping[str, str]


def render(
    cells: list[CellData],
    details: Details | None,
    audits: Mapping[str, str] = MappingProxyType({}),
    analysis: Sequence[Table] = (),
) -> str:
    """The page as HTML.

    Args:
        cells: in the order in which they are shown; of a large campaign without records and
            questions.
        details: None: they lie in files beside the page, and its cells are browsed.
        audits: path of an audit's page by the audit's hash.
        analysis: statistics to show.
    """
    drawn = _browsed(cells) if details is None else _whole(cells, details)
    return (
        environment()
        .get_template("page.html.j2")
        .render(
            cells=cells,
            audits=audits,
            style=source("style.css"),
            slots=SLOTS,
            stages=STAGE_NAMES,
            summary=summary(cells, audits),
            analysis=page_parts(analysis),
            most=MOST_NOTICES,
            version=__version__,
            **_tables(cells),
            **drawn,
        )
    )


def _tables(cells: list[CellData]) -> dict[str, Any]:
    """The tables that the files have too, and what must be known before reading them."""
    rows = rows_from_cells(cells)
    found = {table.name: table for table in all_tables(rows)}
    sized = any(row.total_b or row.architecture for row in rows)
    common, means = common_notes([grid(found[name]) for name in MEAN_TABLES])
    more = ("strata", "domain_differences", *(("foundation_models",) if sized else ()))
    means += [without_notes(grid(found[name]), common) for name in more]
    told, ranks = common_notes(
        [
            one
            for table in (found["ranks_model"], found["ranks_domain"])
            if len(table.rows) > 1
            for one in rank_grids(table)
        ]
    )
    seeing, answerers = found.get(SEEING), found.get(ANSWERERS)
    return {
        "notices": notices(rows, cells),
        "means": means,
        "means_notes": common,
        "folded": _FOLDED,
        "ranks": ranks,
        "ranks_notes": told,
        "seeing": None if seeing is None else grid(seeing),
        "answerers": None if answerers is None else grid(answerers),
        "seeing_plot": Markup(seeing_plot(seeing, answerers)),
    }


def _whole(cells: list[CellData], details: Details) -> dict[str, Any]:
    own = [cell for cell in cells if not cell.is_control]
    controls = [cell for cell in cells if cell.is_control]

    def failures(group: list[CellData]) -> Any:
        ids = [cell.id for cell in group if cell.score is not None]
        return grid(failures_by_cell(group), links=lambda row: f"#{ids[row]}") if ids else None

    return {
        "browse": False,
        "views": details.views,
        "tolerated": {cell.id: tolerated(cell) for cell in cells},
        "groups": [(name, of) for name, of in (("models", own), ("controls", controls)) if of],
        "matrix": Markup(matrix(own)),
        "controls_matrix": Markup(matrix(controls)) if controls else "",
        "failures": failures(own),
        "controls_failures": failures(controls),
        "data": Markup(script_json(details.pictures)),
        "script": source("page.js"),
    }


def _browsed(cells: list[CellData]) -> dict[str, Any]:
    own = [cell for cell in cells if not cell.is_control]
    controls = [cell for cell in cells if cell.is_control]
    return {
        "browse": True,
        "failures": grid(failures_by_model(own)) if own else None,
        "controls_failures": grid(failures_by_model(controls)) if controls else None,
        "controls_matrix": "",
        "data": Markup(script_json(browsed_rows(cells))),
        "script": source("browse.js"),
    }


def environment() -> jinja2.Environment:
    """The templates, with their filters."""
    return templates(_HERE)


def source(name: str) -> Markup:
    """A file beside this one, as it is."""
    return Markup((_HERE / name).read_text("utf-8"))


def script_json(value: Any) -> str:
    """JSON that can stand in a script element, whatever its texts hold.

    A text could end the element, or open a comment and a script in it, so that its end isn't seen.
    """
    return json.dumps(value, sort_keys=True).replace("<", "\\u003c")
