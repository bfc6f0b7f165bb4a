"""The page of a campaign as HTML, from its cells and the tables that are made of them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jinja2
from jinja2 import Template
from markupsafe import Markup

from ssp_core import __version__
from ssp_core.templates import templates
from ssp_eval.causes.findings import MovedAnswers
from ssp_eval.causes.forest import forests
from ssp_eval.causes.tables import FINDINGS, moved_tables
from ssp_eval.data.audit import Audit
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.evaluate.clients.models import BEST_CONSTANT, BLIND, condition_of
from ssp_eval.evaluate.store.admission import UNAUDITED, UNPAIRED
from ssp_eval.evaluate.store.results import AuditCache, CellData, read_cells
from ssp_eval.pages import number, style
from ssp_eval.report.cell_view import RecordView, tolerated
from ssp_eval.score.aggregate import Mean
from ssp_eval.score.cell import STAGES
from ssp_eval.score.cli import format_response
from ssp_eval.score.metrics import BY_NAME, COMPONENT_RATIOS, DIAGNOSTIC, METRIC_LABELS
from ssp_eval.statistics.constants import (
    MARK,
    OfScenario,
    Place,
    constant_rows,
    constant_table,
    constants_of_cells,
    is_below,
)
from ssp_eval.statistics.rows import CellRow, compared_labels, rows_from_cells
from ssp_eval.statistics.table import Table, Value, by_column
from ssp_eval.statistics.tables.controls import ANSWERERS, SEEING
from ssp_eval.statistics.tables.grids import Grid, common_notes, grid, without_notes
from ssp_eval.statistics.tables.labels import label_table
from ssp_eval.statistics.tables.notices import lead, notices
from ssp_eval.statistics.tables.responses import response_table
from ssp_eval.statistics.tables.scores import MEAN_TABLES, all_tables
from ssp_eval.statistics.tables.statistics import STAGE_NAMES, failures_by_cell, failures_by_model

COLUMNS = tuple(BY_NAME[name] for name in (*COMPONENT_RATIOS, *DIAGNOSTIC))
# Cells that are scored and stay out of domain means (METHOD 4).
MARKS = {UNPAIRED: "†", UNAUDITED: "‡"}
# One hue from light to dark: readable without colour vision and in print.
_LIGHT, _DARK = (214, 228, 240), (8, 64, 129)
# Room for a name, and px of a letter of it; a longer one is cut.
_NAME, _LETTER, _MOST_LETTERS = 140.0, 7.2, 40
_HERE = Path(__file__).parent
NO_CONSTANTS: Mapping[Place, float] = MappingProxyType({})


def _template(name: str) -> Template:
    return environment().get_template(name)


def shade(value: float) -> str:
    """Colour of a score in [0, 1]."""
    share = min(max(value, 0.0), 1.0)
    mixed = (round(a + (b - a) * share) for a, b in zip(_LIGHT, _DARK, strict=True))
    return "#" + "".join(f"{part:02x}" for part in mixed)


def matrix(cells: Sequence[CellData], constants: Mapping[Place, float] = NO_CONSTANTS) -> str:
    """Return the figure as SVG, one row per cell, in the order given (scenarios together).

    Args:
        cells: of the campaign.
        constants: IVCS of the best blind constant by scenario and domain.
    """

    def name(cell: CellData) -> str:
        text = f"{cell.model} {MARKS.get(cell.admission, '')}".rstrip()
        return text if len(text) <= _MOST_LETTERS else text[: _MOST_LETTERS - 1] + "…"

    marked = sorted({cell.admission for cell in cells} & set(MARKS))
    compared = compared_labels(cells).items()
    longest = max((len(name(cell)) for cell in cells), default=0)
    return _template("matrix.svg.j2").render(
        cells=cells,
        columns=COLUMNS,
        in_ivcs=len(COMPONENT_RATIOS),
        apart={scenario for scenario, comparison in compared if not comparison.comparable},
        marked=" · ".join(f"{MARKS[status]} {status}" for status in marked),
        push=max(0.0, longest * _LETTER - _NAME),
        name=name,
        shade=shade,
        constants=constants,
        is_below=is_below,
        below=MARK,
        response=format_response,
        stages=STAGES,
        stage_names=STAGE_NAMES,
    )


_SPOILT = {"black": "black frames", "shuffled": "frames of other times", BLIND: "no pictures"}
# Answerers that see no frame: what a model must beat to show that it looks.
_BLIND = ("constant_velocity", "copy_history", BEST_CONSTANT)


def seeing_plot(seeing: Table | None, answerers: Table | None) -> str:
    """Return the figure as SVG, one row per model; empty where no model was asked blindly."""
    models: dict[str, dict[str, tuple[float, float]]] = {}
    for row in by_column(seeing):
        own, spoilt = _number(row["ivcs"]), _number(row["ivcs_spoilt"])
        if own is not None and spoilt is not None:
            models.setdefault(str(row["model"]), {})[str(row["condition"])] = (own, spoilt)
    if not models:
        return ""
    blind = {
        str(row["model"]): value
        for row in by_column(answerers)
        if _sees_nothing(str(row["model"]), models) and (value := _number(row["ivcs"])) is not None
    }
    conditions = {condition for scores in models.values() for condition in scores}
    legend = [("own", "as it is"), *(item for item in _SPOILT.items() if item[0] in conditions)]
    if blind:
        legend.append(("answerer", "answerer that sees nothing"))
    return _template("seeing.svg.j2").render(
        models=models, blind=blind, spoilt_names=_SPOILT, legend=legend
    )


def _sees_nothing(name: str, models: Collection[str]) -> bool:
    """Tell whether a blind answerer has its own row, since no model's row shows it."""
    model, condition = condition_of(name)
    return name in _BLIND or (condition == BLIND and model not in models)


def _number(value: Value) -> float | None:
    return value.value if isinstance(value, Mean) else None


# Beyond, a table is only begun; the files of --tables hold it whole.
MOST_ROWS = 120
_PARTS = (
    ("Intervals", "intervals_"),
    ("Paired comparisons", "comparisons"),
    ("Sensitivity", "weights_"),
    ("Stability over runs", "stability"),
)


def statistics_parts(tables: Sequence[Table]) -> dict[str, list[Grid]]:
    """Return by title the non-empty parts of the statistics, in a fixed order."""
    parts: dict[str, list[Grid]] = {}
    for title, prefix in _PARTS:
        for table in tables:
            if table.name.startswith(prefix) and table.rows:
                parts.setdefault(title, []).append(grid(_begun(table)))
    return parts


def moved_part(moved: MovedAnswers | None) -> dict[str, Any] | None:
    """Return the content of the section "What moved the answer"; None where nothing was changed."""
    if moved is None:
        return None
    tables = [one for one in moved_tables(moved) if one.name != FINDINGS]
    return {
        "models": [*zip(moved.findings, forests(moved.effects), strict=True)],
        "tables": [grid(_begun(table)) for table in tables],
    }


def _begun(table: Table) -> Table:
    """Return a long table's first rows, with a note that says so, and all notes under it."""
    if len(table.rows) <= MOST_ROWS:
        return replace(table, notes=table.all_notes)
    note = f"The first {MOST_ROWS} of {len(table.rows)} rows; ssp report --tables DIR writes all."
    return replace(table, rows=table.rows[:MOST_ROWS], notes=(note, *table.all_notes))


def summary(cells: Sequence[CellData], audits: Mapping[str, str]) -> dict[str, Any]:
    """Return the summary of all cells of a campaign.

    Args:
        cells: in the order in which they are shown.
        audits: pages of the audits by hash, as paths from the report.
    """
    own = [cell for cell in cells if not cell.is_control]
    controls = [cell for cell in cells if cell.is_control]
    models = tuple(dict.fromkeys(cell.model for cell in own))
    scenarios = tuple(sorted({cell.scenario for cell in cells}))
    return {
        "title": _title(models, scenarios),
        "scenarios": scenarios,
        "domains": tuple(dict.fromkeys(cell.domain for cell in cells)),
        "models": models,
        "controls": tuple(sorted({cell.model for cell in controls})),
        # Of models and of controls: label times of scored cells, scored cells, lost answers.
        "labels": (_labels(own), _labels(controls)),
        "scored": _scored(own),
        "scored_controls": _scored(controls),
        "missing": (_missing(own), _missing(controls)),
        "statuses": dict(sorted(Counter(c.facts.status for c in cells if not c.score).items())),
        "admissions": tuple(sorted({cell.admission for cell in cells})),
        "audit_links": tuple(_audit_links(cells, audits).items()),
    }


def _scored(cells: Sequence[CellData]) -> tuple[int, int]:
    return sum(cell.score is not None for cell in cells), len(cells)


def _labels(cells: Sequence[CellData]) -> int:
    return sum(cell.score.n for cell in cells if cell.score is not None)


def _missing(cells: Sequence[CellData]) -> int:
    return sum(len(cell.facts.answers.missing) for cell in cells if cell.score is not None)


def _title(models: Sequence[str], scenarios: Sequence[str]) -> str:
    """Describe who was evaluated on what, in words; counts where there are many."""

    def listed(names: Sequence[str], many: str) -> str:
        words = [name.replace("_", " ") for name in names]
        return " and ".join(words) if 0 < len(words) <= 2 else f"{len(words)} {many}"

    title = f"{listed(models, 'models')} on {listed(scenarios, 'scenarios')}"
    return title[0].upper() + title[1:]


def _audit_links(cells: Sequence[CellData], audits: Mapping[str, str]) -> dict[str, str]:
    """Return the page of the audit by scenario."""
    links: dict[str, str] = {}
    for cell in cells:
        page = audits.get(cell.audit_sha256 or "")
        if page is not None:
            links.setdefault(cell.scenario, page)
    return links


# In a row's word of stages: 0 to 6 for the stage that fails first, this where none does.
CLEAN = "-"
# Scores of a row before its risk response and after it.
BEFORE_RISK = ("ivcs", *COMPONENT_RATIOS)
SCORES = (*BEFORE_RISK, *DIAGNOSTIC)


def load_lightly(
    files: Sequence[Path], on_cell: Callable[[CellData], None] = lambda _: None
) -> list[CellData]:
    """Read cells and keep of each what the page itself needs.

    Args:
        files: cell.json of each cell, of one campaign.
        on_cell: given each cell whole, before its records, questions and judgements are dropped.

    Raises:
        InputError: a file is damaged.
    """
    cells = []
    audits = AuditCache(files[0].parents[2])
    for cell in read_cells(files, audits):
        on_cell(cell)
        cells.append(replace(cell, records=(), request_lines=()))
    return cells


def rows(cells: Sequence[CellData], constants: Mapping[Place, float]) -> dict[str, Any]:
    """Make the rows of the page's script: one list per cell, names by their number.

    Args:
        cells: of the campaign.
        constants: IVCS of the best blind constant by scenario and domain.
    """
    names: dict[str, list[str]] = {
        key: list(dict.fromkeys(getattr(cell, key) for cell in cells))
        for key in ("scenario", "domain", "model")
    }
    number = {key: {name: k for k, name in enumerate(members)} for key, members in names.items()}
    return {
        **names,
        "scores": SCORES,
        "before_risk": len(BEFORE_RISK),
        "rows": [
            [
                cell.id,
                *(number[key][getattr(cell, key)] for key in names),
                cell.facts.status,
                cell.admission,
                int(cell.is_control),
                _stages(cell),
                None if cell.score is None else [_short(getattr(cell.score, s)) for s in SCORES],
                None if cell.score is None else _short(cell.score.rl_s),
                "; ".join(cell.facts.reasons),
                _short(constants.get((cell.scenario, cell.domain))),
            ]
            for cell in cells
        ],
    }


def _stages(cell: CellData) -> str:
    """Return per label, in order, the first stage that fails (METHOD 6.12)."""
    if cell.score is None:
        return ""
    stages = (judgement.first_failure for judgement in cell.score.details.judgements)
    return "".join(CLEAN if stage is None else str(STAGES.index(stage)) for stage in stages)


def _short(value: float | None) -> float | None:
    """Return a number with enough digits to sort by and to show."""
    return None if value is None else round(value, 6)


# Means that a page shows folded: each has many rows, or is for those who look closer.
_FOLDED = (
    "by_scenario_model",
    "by_domain_model",
    "strata",
    "domain_differences_model",
    "foundation_models",
)
# Notices that aren't about all cells, before a page only counts them.
MOST_NOTICES = 12


@dataclass(frozen=True)
class Details:
    """The details behind each cell, of a page that holds everything.

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
    cell_audits: Sequence[Audit] = (),
    moved: MovedAnswers | None = None,
    expected: Sequence[str] = (),
    carried: str = "",
) -> str:
    """Return the page as HTML.

    Args:
        cells: in the order in which they are shown; of a large campaign without records and
            questions.
        details: None: they lie in files beside the page, and its cells are browsed.
        audits: pages of the audits by hash, as paths from the report.
        analysis: tables of the statistics.
        cell_audits: those that the cells go by.
        moved: what moved the answers; None: nothing was asked with a cause changed.
        expected: scenarios that the campaign was planned with.
        carried: options that it is made with, as JSON; empty: it carries none.
    """
    cell_rows = rows_from_cells(cells)
    constants = constants_of_cells(cell_rows, cells)
    blind = _of_recordings(constants)
    responses = response_table(cell_audits)
    cells_context = _browsed(cells, blind) if details is None else _whole(cells, details, blind)
    return (
        environment()
        .get_template("page.html.j2")
        .render(
            cells=cells,
            audits=audits,
            style=style(),
            slots=SLOT_NAMES,
            stages=STAGE_NAMES,
            summary=summary(cells, audits),
            analysis=statistics_parts(analysis),
            labels=grid(label_table(cells, cell_audits)),
            responses=None if responses is None else grid(responses),
            moved=moved_part(moved),
            most=MOST_NOTICES,
            version=__version__,
            carried=carried,
            **_tables(cells, cell_rows, constants, expected),
            **cells_context,
        )
    )


def _of_recordings(constants: Sequence[OfScenario]) -> dict[Place, float]:
    """Return IVCS of the best blind constant by scenario and domain."""
    rows = constant_rows(constants)
    return {(row.scenario, row.domain): row.ivcs for row in rows if row.ivcs is not None}


def _tables(
    cells: list[CellData],
    rows: Sequence[CellRow],
    constants: Sequence[OfScenario],
    expected: Sequence[str],
) -> dict[str, Any]:
    """Return the tables that the files have too, and what must be known before reading them."""
    tables = {table.name: table for table in all_tables([*rows, *constant_rows(constants)])}
    sized = any(row.total_b or row.architecture for row in rows)
    common, means = common_notes([grid(tables[name]) for name in MEAN_TABLES])
    differences = ("domain_differences", "domain_differences_model")
    more = ("strata", *differences, *(("foundation_models",) if sized else ()))
    means += [without_notes(grid(tables[name]), common) for name in more]
    rank_notes, ranks = common_notes(
        [
            grid(table)
            for table in (tables["ranks_model"], tables["ranks_domain"])
            if len(table.rows) > 1
        ]
    )
    seeing, answerers = tables.get(SEEING), tables.get(ANSWERERS)
    return {
        "notices": notices(rows, cells, expected),
        "lead": lead(rows),
        "means": means,
        "means_notes": common,
        "folded": _FOLDED,
        "ranks": ranks,
        "ranks_notes": rank_notes,
        "seeing": None if seeing is None else grid(seeing),
        "answerers": None if answerers is None else grid(answerers),
        "constants": grid(constant_table(constants)) if constants else None,
        "seeing_plot": Markup(seeing_plot(seeing, answerers)),
    }


def _whole(
    cells: list[CellData], details: Details, constants: Mapping[Place, float]
) -> dict[str, Any]:
    own = [cell for cell in cells if not cell.is_control]
    controls = [cell for cell in cells if cell.is_control]

    def failures(group: list[CellData]) -> Grid | None:
        links = [f"#{cell.id}" for cell in group if cell.score is not None]
        return grid(failures_by_cell(group), links) if links else None

    return {
        "browse": False,
        "views": details.views,
        "tolerated": {cell.id: tolerated(cell) for cell in cells},
        "groups": [(name, of) for name, of in (("models", own), ("controls", controls)) if of],
        "matrix": Markup(matrix(own, constants)),
        "controls_matrix": Markup(matrix(controls, constants)) if controls else "",
        "failures": failures(own),
        "controls_failures": failures(controls),
        "data": Markup(script_json(details.pictures)),
        "script": source("page.js"),
    }


def _browsed(cells: list[CellData], constants: Mapping[Place, float]) -> dict[str, Any]:
    own = [cell for cell in cells if not cell.is_control]
    controls = [cell for cell in cells if cell.is_control]
    return {
        "browse": True,
        "browsed_columns": [
            *((key, key) for key in ("scenario", "domain", "model")),
            *((key, METRIC_LABELS[key]) for key in BEFORE_RISK),
            ("risk", "risk"),
            *((key, METRIC_LABELS[key]) for key in DIAGNOSTIC),
            ("failures", "first failures"),
        ],
        "failures": grid(failures_by_model(own)) if own else None,
        "controls_failures": grid(failures_by_model(controls)) if controls else None,
        "controls_matrix": "",
        "data": Markup(script_json(rows(cells, constants))),
        "script": source("browse.js"),
    }


def environment() -> jinja2.Environment:
    """Return the templates, with their filters."""
    page_templates = templates(_HERE)
    page_templates.filters["px"] = number
    return page_templates


def source(name: str) -> Markup:
    """Return a file beside this one, as it is."""
    return Markup((_HERE / name).read_text("utf-8"))


def script_json(value: Any) -> str:
    """Return JSON that can stand in a script element, whatever its texts hold.

    A text could end the element, or open a comment and a script in it, so that its end isn't seen.
    """
    return json.dumps(value, sort_keys=True).replace("<", "\\u003c")
