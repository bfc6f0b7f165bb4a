"""What figures with a name per row share: pages of rows, a legend above, names at the left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes

from ssp_eval.figures.drawing import pages_of
from ssp_eval.figures.legend import legend_height_in, mark_legend
from ssp_eval.figures.style import Look, Sheet, widest_in

NO_MODEL = "no cell of a model may enter means"
COMPONENTS = ("jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr")
SCORES = (*COMPONENTS, "ivcs")
ROW_IN = 0.17
_MOST_ROWS = 46


def row_pages(names: Sequence[str]) -> list[Sequence[str]]:
    """The names in as few pages as hold a row for each."""
    return pages_of(names, _MOST_ROWS)


def name_rows(axes: Axes, labels: Sequence[str]) -> None:
    """One row per label from top to bottom, with the label at its left."""
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.set_yticks(range(len(labels)), labels)
    axes.tick_params(axis="y", length=0)


def named_rows(
    width_in: float,
    labels: Sequence[str],
    legend: Mapping[str, Look],
    right_in: float = 0.12,
    row_in: float = ROW_IN,
) -> tuple[Sheet, Axes, float]:
    """A sheet with a row per label under a legend.

    Args:
        width_in: of the sheet.
        labels: from top to bottom.
        legend: marks by name; empty: there is none.
        right_in: room at the right of the rows.
        row_in: height of a row.

    Returns:
        The sheet, its axes, and where these begin below its upper border, in.
    """
    head_in = 0.05 + (legend_height_in(list(legend), width_in) if legend else 0.03)
    left_in = widest_in(labels) + 0.12
    height_in = row_in * len(labels)
    sheet = Sheet(width_in, head_in + height_in + 0.42)
    mark_legend(sheet, legend, 0.11)
    axes = sheet.axes(left_in, head_in, width_in - left_in - right_in, height_in)
    name_rows(axes, labels)
    return sheet, axes, head_in
