"""The page's drawings: the result matrix (METHOD 7.1), and what seeing is worth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Template

from ssp_core.templates import templates
from ssp_eval.evaluate.admission import UNAUDITED, UNPAIRED
from ssp_eval.evaluate.results import CellData
from ssp_eval.pages import number
from ssp_eval.score.aggregate import Mean
from ssp_eval.score.cell import STAGES
from ssp_eval.score.cli import format_response
from ssp_eval.score.metrics import BY_NAME, COMPONENTS, DIAGNOSTIC
from ssp_eval.statistics.rows import compared_labels
from ssp_eval.statistics.statistics_tables import STAGE_NAMES
from ssp_eval.statistics.table import Table, Value, by_column

# The response, the fifth component, has a column of its own.
IN_IVCS = 4
COLUMNS = tuple(BY_NAME[name] for name in (*COMPONENTS[:IN_IVCS], *DIAGNOSTIC))
# Cells that are scored and stay out of domain means (METHOD 4).
MARKS = {UNPAIRED: "†", UNAUDITED: "‡"}
# One hue from light to dark: readable without colour vision and in print.
_LIGHT, _DARK = (214, 228, 240), (8, 64, 129)
# Room for a name, and px of a letter of it; a longer one is cut.
_NAME, _LETTER, _MOST_LETTERS = 140.0, 7.2, 40
_HERE = Path(__file__).parent


def _template(name: str) -> Template:
    environment = templates(_HERE)
    environment.filters["px"] = number
    return environment.get_template(name)


def shade(value: float) -> str:
    """Colour of a score in [0, 1]."""
    share = min(max(value, 0.0), 1.0)
    mixed = (round(a + (b - a) * share) for a, b in zip(_LIGHT, _DARK, strict=True))
    return "#" + "".join(f"{part:02x}" for part in mixed)


def matrix(cells: Sequence[CellData]) -> str:
    """The figure as SVG, one row per cell, in the order given (scenarios together)."""

    def name(cell: CellData) -> str:
        text = f"{cell.model} {MARKS.get(cell.admission, '')}".rstrip()
        return text if len(text) <= _MOST_LETTERS else text[: _MOST_LETTERS - 1] + "…"

    marked = sorted({cell.admission for cell in cells} & set(MARKS))
    compared = compared_labels(cells).items()
    longest = max((len(name(cell)) for cell in cells), default=0)
    return _template("matrix.svg.j2").render(
        cells=cells,
        columns=COLUMNS,
        in_ivcs=IN_IVCS,
        apart={scenario for scenario, found in compared if not found.comparable},
        marked=" · ".join(f"{MARKS[status]} {status}" for status in marked),
        push=max(0.0, longest * _LETTER - _NAME),
        name=name,
        shade=shade,
        response=format_response,
        stages=STAGES,
        stage_names=STAGE_NAMES,
    )


_SPOILT = {"black": "black frames", "shuffled": "frames of other times"}
# Answerers that see no frame: what a model must beat to show that it looks.
_BLIND = ("constant_velocity", "copy_history")


def seeing_plot(seeing: Table | None, answerers: Table | None) -> str:
    """The figure as SVG, one row per model; empty where no model was asked blindly."""
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
        if row["model"] in _BLIND and (value := _number(row["ivcs"])) is not None
    }
    legend = [("own", "as it is"), *_SPOILT.items()]
    if blind:
        legend.append(("answerer", "answerer that sees nothing"))
    return _template("seeing.svg.j2").render(
        models=models, blind=blind, spoilt_names=_SPOILT, legend=legend
    )


def _number(value: Value) -> float | None:
    return value.value if isinstance(value, Mean) else None
