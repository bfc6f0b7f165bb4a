"""The result matrix (METHOD 7.1): every cell against its scores, circle area and shade."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from ssp_eval.figures.scores import Scores, words
from ssp_eval.figures.style import (
    FAINT,
    GREY,
    INK,
    MOST_HEIGHT_IN,
    PAGE_IN,
    RED,
    SMALL_PT,
    UNITS,
    Drawing,
    LeftOut,
    Sheet,
    caption,
    fitted,
    names_in,
    page_name,
    renamed,
    text_width_in,
)
from ssp_eval.score.cli import NULL, format_ratio, format_response
from ssp_eval.score.metrics import COMPONENT_RATIOS, METRIC_LABELS
from ssp_eval.statistics.constants import CONSTANT, MARK
from ssp_eval.statistics.rows import OK, CellRow

NAME = "matrix"
_IN_IVCS, _BESIDE = COMPONENT_RATIOS, ("act_acc_eff", "atc_eff")
NOT_ADMITTED = "†"
# More take minutes and thousands of files that nobody may have wanted.
MOST_PAGES = 24
# One hue from light to dark, readable without colour vision and in print.
_LIGHT, _DARK = (0.84, 0.90, 0.95), (0.03, 0.25, 0.51)

_ROW_IN, _BAND_IN, _HEAD_IN, _FOOT_IN = 0.2, 0.2, 0.46, 0.5
_RADIUS_IN = 0.088
_DOMAIN_IN, _MODEL_IN = 0.72, 1.55
_RISK_IN, _IVCS_IN = 0.55, 0.88
_LEFT_IN = 0.05


@dataclass(frozen=True)
class _Line:
    """A line of a page: a scenario's band, or a cell with what is new in it."""

    scenario: str
    cell: CellRow | None = None
    domain: str = ""


def matrix(scores: Scores, whole: bool = False) -> Iterator[Drawing | LeftOut]:
    """Yield the matrix of the models, and that of the controls, on the pages that they need.

    Args:
        scores: of the rows.
        whole: draw it also where it has more than MOST_PAGES pages.
    """
    if not scores.matrix_rows:
        yield LeftOut(NAME, "there are no cells")
        return
    names = names_in(sorted({row.model for row in scores.matrix_rows}), _MODEL_IN - 0.2)
    for name, is_control in ((NAME, False), (f"{NAME}_controls", True)):
        cells = [cell for cell in scores.matrix_rows if cell.control is is_control]
        pages = _paged(cells) if cells else []
        if len(pages) > MOST_PAGES and not whole:
            yield LeftOut(
                name, f"{len(cells)} cells are {len(pages)} pages; ask for them with --only matrix"
            )
            continue
        for number, lines in enumerate(pages, start=1):
            yield _page(page_name(name, number, len(pages)), lines, names, scores)


def shade(value: float) -> tuple[float, float, float]:
    """Colour of a score in [0, 1]."""
    share = min(max(value, 0.0), 1.0)
    red, green, blue = (a + (b - a) * share for a, b in zip(_LIGHT, _DARK, strict=True))
    return red, green, blue


def _paged(cells: Sequence[CellRow]) -> list[list[_Line]]:
    """Return lines page by page; scenario and domain are named again where a page begins."""
    room = MOST_HEIGHT_IN - _HEAD_IN - _FOOT_IN
    pages: list[list[_Line]] = [[]]
    used = 0.0
    for cell in cells:
        page = pages[-1]
        fresh = not page or page[-1].scenario != cell.scenario
        needed = _ROW_IN + (_BAND_IN if fresh else 0.0)
        if page and used + needed > room:
            pages.append([])
            page, used, fresh, needed = pages[-1], 0.0, True, _ROW_IN + _BAND_IN
        if fresh:
            page.append(_Line(cell.scenario))
        before = page[-1].cell
        new = before is None or before.domain != cell.domain
        page.append(_Line(cell.scenario, cell, cell.domain if new else ""))
        used += needed
    return pages


def _column_x(index: int) -> float:
    start = _LEFT_IN + _DOMAIN_IN + _MODEL_IN + 0.16
    room = PAGE_IN - start - _RISK_IN - _IVCS_IN - 0.1
    return start + room / (len(_IN_IVCS) + len(_BESIDE)) * index


def _page(name: str, lines: Sequence[_Line], names: dict[str, str], scores: Scores) -> Drawing:
    height = _HEAD_IN + _FOOT_IN + sum(_ROW_IN if line.cell else _BAND_IN for line in lines)
    sheet = Sheet(PAGE_IN, height)
    axes = sheet.page()
    _head(axes)
    y = _HEAD_IN
    for index, line in enumerate(lines):
        if line.cell is None:
            band = Rectangle((0.0, y), PAGE_IN, _BAND_IN, color="#eeeeee", linewidth=0)
            axes.add_patch(band)
            axes.text(
                _LEFT_IN,
                y + _BAND_IN / 2,
                fitted(words(line.scenario), PAGE_IN - 0.2),
                va="center_baseline",
                weight="bold",
            )
            y += _BAND_IN
            continue
        if line.domain:
            axes.plot([0.0, PAGE_IN], [y, y], color=FAINT, linewidth=0.5)
            axes.text(
                _LEFT_IN,
                y + _ROW_IN / 2,
                fitted(line.domain, _DOMAIN_IN - 0.05),
                va="center_baseline",
            )
        _row(axes, index, line.cell, y + _ROW_IN / 2, names, scores)
        y += _ROW_IN
    axes.plot([0.0, PAGE_IN], [y, y], color=GREY, linewidth=0.6)
    cells = [line.cell for line in lines if line.cell is not None]
    _foot(axes, y + 0.15, cells, bool(scores.constants))
    used = {cell.model: names[cell.model] for cell in cells}
    return Drawing(name, sheet.figure, _caption(cells, used, scores))


def _head(axes: Axes) -> None:
    columns = (*_IN_IVCS, *_BESIDE)
    for index, key in enumerate(columns):
        axes.text(_column_x(index) - _RADIUS_IN, _HEAD_IN - 0.07, METRIC_LABELS[key])
    first = _column_x(0) - _RADIUS_IN
    second = _column_x(len(_IN_IVCS)) - _RADIUS_IN
    for x, text in ((first, "components of IVCS"), (second, "diagnostic")):
        axes.text(x, 0.15, text, color=GREY)
    end = PAGE_IN - _RISK_IN - _IVCS_IN
    for a, b in ((first, second - 0.12), (second, end - 0.12), (end, PAGE_IN - 0.05)):
        axes.plot([a, b], [0.2, 0.2], color=GREY, linewidth=0.5)
    axes.text(end, 0.15, "outcome", color=GREY)
    axes.text(end, _HEAD_IN - 0.07, "risk")
    axes.text(PAGE_IN - _IVCS_IN, _HEAD_IN - 0.07, "IVCS")
    axes.plot([0.0, PAGE_IN], [_HEAD_IN, _HEAD_IN], color=GREY, linewidth=0.6)


def _row(
    axes: Axes, index: int, cell: CellRow, y: float, names: dict[str, str], scores: Scores
) -> None:
    mark = "" if cell.admitted or cell.status != OK else f" {NOT_ADMITTED}"
    axes.text(_LEFT_IN + _DOMAIN_IN, y, names[cell.model] + mark, va="center_baseline")
    if cell.status != OK:
        room = PAGE_IN - _column_x(0)
        text = f"{cell.status}: {cell.reason or 'no reason given'}"
        axes.text(
            _column_x(0) - _RADIUS_IN,
            y,
            fitted(text, room, head=1.0),
            va="center_baseline",
            color=GREY,
            gid=f"refused-{index}",
        )
        return
    for column, key in enumerate((*_IN_IVCS, *_BESIDE)):
        _mark(axes, _column_x(column), y, getattr(cell, key), f"score-{index}-{key}")
    end = PAGE_IN - _RISK_IN - _IVCS_IN
    axes.text(end, y, risk_text(cell), va="center_baseline")
    ivcs = cell.ivcs or 0.0
    left, width, height = PAGE_IN - _IVCS_IN, 0.42, 0.09
    for share, colour in ((1.0, "#f0f0f0"), (ivcs, shade(ivcs))):
        bar = Rectangle((left, y - height / 2), width * share, height, color=colour, linewidth=0)
        axes.add_patch(bar)
    constant = scores.constants.get((cell.scenario, cell.domain))
    if constant is not None:
        x = left + width * (constant.score["ivcs"] or 0.0)
        axes.plot(
            [x, x],
            [y - _ROW_IN / 2, y + _ROW_IN / 2],
            color=RED,
            linewidth=0.9,
            gid=f"constant-{index}",
        )
    flag = "*" if cell.ivcs_nulls else ""
    if scores.is_below(cell):
        flag += f" {MARK}"
    axes.text(left + width + 0.05, y, format_ratio(cell.ivcs) + flag, va="center_baseline")


def risk_text(cell: CellRow) -> str:
    """Return ``S@1.50``, ``F``, or the share of several runs that responded."""
    if cell.rsr is None:
        return NULL
    if cell.rsr in (0.0, 1.0):
        return format_response(int(cell.rsr), cell.rl_s)
    return f"{cell.rsr:.0%}".replace("%", " %")


def _mark(axes: Axes, x: float, y: float, value: float | None, gid: str) -> None:
    if value is None:
        axes.text(x, y, NULL, ha="center", va="center_baseline", gid=gid)
        return
    if value > 0.0:
        radius = _RADIUS_IN * math.sqrt(min(value, 1.0))
        circle = Circle((x, y), radius, facecolor=shade(value), edgecolor=INK, linewidth=0.3)
    else:
        circle = Circle((x, y), 0.02, facecolor="white", edgecolor=INK, linewidth=0.5)
    circle.set_gid(gid)
    axes.add_patch(circle)
    axes.text(x + _RADIUS_IN + 0.03, y, f"{value:.2f}", va="center_baseline")


def _foot(axes: Axes, y: float, cells: Sequence[CellRow], has_constant: bool) -> None:
    x = _LEFT_IN
    axes.text(x, y, "area and shade:", va="center_baseline", color=GREY)
    x += text_width_in("area and shade:") + 0.2
    for value in (0.0, 0.25, 0.5, 0.75, 1.0):
        _mark(axes, x, y, value, f"legend-{value:g}")
        x += 0.5
    notes = ["S@t: response to the risk after t seconds", "F: none", f"{NULL}: no denominator"]
    if any(cell.ivcs_nulls for cell in cells):
        notes.append("*: a component without denominator counts as 0")
    if has_constant:
        notes.append(f"line on IVCS: {CONSTANT}; {MARK}: below it")
    if any(not cell.admitted and cell.status == OK for cell in cells):
        notes.append(f"{NOT_ADMITTED}: in no domain mean")
    # Two lines at most, which the foot has room for beside and below the legend.
    lines: list[str] = []
    line = ""
    for note in notes:
        longer = f"{line}; {note}" if line else note
        room = PAGE_IN - (x if not lines else _LEFT_IN) - 0.05
        if line and text_width_in(longer) > room:
            lines.append(line)
            longer = note
        line = longer
    lines.append(line)
    for number, text in enumerate(lines):
        axes.text(
            x if number == 0 else _LEFT_IN,
            y + 0.18 * number,
            text,
            va="center_baseline",
            color=GREY,
            size=SMALL_PT,
        )


def _caption(cells: Sequence[CellRow], names: dict[str, str], scores: Scores) -> str:
    refused = sum(cell.status != OK for cell in cells)
    unpaired = sum(not cell.admitted and cell.status == OK for cell in cells)
    counts = sorted({cell.n for cell in cells if cell.n is not None})
    labels = f" Labels per cell: {', '.join(map(str, counts))}." if counts else ""
    runs = any(cell.run.startswith("mean of") for cell in cells)
    lost = scores.lost_runs([cell.key for cell in cells])
    control = cells[0].control
    alike = [cell for cell in scores.matrix_rows if cell.control is control]
    return caption(
        f"Result matrix: scenario × domain × model against the scores of METHOD 6; {len(cells)} of "
        f"{scores.n_text(alike)}.{labels}",
        "These are controls, which check the harness and enter no mean." if control else "",
        "Area and shade of a circle both grow with the score, and its number stands beside it; an "
        "open dot is 0.",
        "S@t is a risk response t seconds after the risk's onset, F none.",
        f"{refused} refused or failed: {_reasons(cells)}." if refused else "",
        f"{unpaired} not admitted by the transfer audit, or with labels that don't compare "
        f"({NOT_ADMITTED})."
        if unpaired
        else "",
        "Where a cell has several runs, their means are shown, and the share that responded."
        if runs
        else "",
        f"Runs without a score, which their cells leave out: {_reasons(lost)}." if lost else "",
        scores.constant_text("The vertical line on IVCS"),
        UNITS,
        "ActAcc and ATC are diagnostic and not part of IVCS.",
        renamed(names),
    )


def _reasons(cells: Sequence[CellRow]) -> str:
    """Return each refused or failed cell with its whole reason."""
    return "; ".join(
        f"{' / '.join(cell.key)}: {cell.reason or 'no reason given'}"
        for cell in cells
        if cell.status != OK
    )
