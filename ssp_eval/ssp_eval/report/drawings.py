"""The page's drawings: the result matrix (METHOD 7.1), and what seeing is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_eval import pages
from ssp_eval.evaluate.admission import UNAUDITED, UNPAIRED
from ssp_eval.evaluate.results import CellData
from ssp_eval.score.aggregate import Mean
from ssp_eval.score.cell import STAGES, CellScore
from ssp_eval.score.cli import NULL, format_response
from ssp_eval.score.metrics import BY_NAME, COMPONENTS, DIAGNOSTIC
from ssp_eval.statistics.rows import compared_labels
from ssp_eval.statistics.statistics_tables import STAGE_NAMES
from ssp_eval.statistics.table import Table, Value

# The response, the fifth component, has a column of its own.
IN_IVCS = 4
COLUMNS = tuple(BY_NAME[name] for name in (*COMPONENTS[:IN_IVCS], *DIAGNOSTIC))
# Cells that are scored and stay out of domain means (METHOD 4).
MARKS = {UNPAIRED: "†", UNAUDITED: "‡"}
# One hue from light to dark: readable without colour vision and in print.
_LIGHT, _DARK = (214, 228, 240), (8, 64, 129)

_ROW = 34.0
_HEAD = 64.0
_BAND = 30.0
_LABELS = 250.0
# Room for a name, and px of a letter of it; a longer one is cut.
_NAME, _LETTER, _MOST_LETTERS = 140.0, 7.2, 40
_COLUMN = 88.0
_RADIUS = 14.0
_SIDE = 402.0
_SQUARE = 13.0
WIDTH = _LABELS + _COLUMN * len(COLUMNS) + _SIDE


def shade(value: float) -> str:
    """Colour of a score in [0, 1]."""
    share = min(max(value, 0.0), 1.0)
    mixed = (round(a + (b - a) * share) for a, b in zip(_LIGHT, _DARK, strict=True))
    return "#" + "".join(f"{part:02x}" for part in mixed)


def matrix(cells: Sequence[CellData]) -> str:
    """The figure as SVG, one row per cell, in the order given (scenarios together)."""
    apart = {name for name, found in compared_labels(cells).items() if not found.comparable}
    # Names longer than usual push everything that follows them to the right.
    longest = min(_MOST_LETTERS, max((len(_name(cell)) for cell in cells), default=0))
    push = max(0.0, longest * _LETTER - _NAME)
    width = WIDTH + push
    parts = [_pushed(_header(), push)]
    y = _HEAD
    scenario = domain = None
    for cell in cells:
        if cell.scenario != scenario:
            scenario, domain = cell.scenario, None
            parts.append(pages.element("rect", x=0, y=y, width=width, height=_BAND, class_="band"))
            title = scenario.replace("_", " ")
            if scenario in apart:
                title += ": not comparable between domains by its labels, in no domain mean"
            parts.append(pages.text(10, y + 20, title, class_="scenario"))
            y += _BAND
        if cell.domain != domain:
            domain = cell.domain
            parts.append(pages.element("line", x1=0, x2=width, y1=y, y2=y, class_="rule"))
            parts.append(pages.text(10, y + _ROW / 2 + 4, domain, class_="domain"))
        parts.append(_row(cell, y, push))
        y += _ROW
    parts.append(pages.element("line", x1=0, x2=width, y1=y, y2=y, class_="rule"))
    parts.append(_legend(y + 26))
    height = y + 52
    marked = {cell.admission for cell in cells} & set(MARKS)
    if marked:
        meaning = " · ".join(f"{MARKS[status]} {status}" for status in sorted(marked))
        text = f"{meaning}: scored, and left out of domain means"
        parts.append(pages.text(10, height, text, class_="note"))
        height += 20
    return pages.element(
        "svg", "".join(parts), class_="matrix", viewBox=f"0 0 {pages.number(width)} {height}",
        role="img", aria_label="Result matrix",
    )  # fmt: skip


def _pushed(content: str, by: float) -> str:
    return (
        pages.element("g", content, transform=f"translate({pages.number(by)} 0)") if by else content
    )


def _name(cell: CellData) -> str:
    mark = MARKS.get(cell.admission, "")
    return cell.model + (f" {mark}" if mark else "")


def _column_x(index: int) -> float:
    gap = 18.0 if index >= IN_IVCS else 0.0
    return _LABELS + _COLUMN * (index + 0.5) - 10 + gap


def _side_x() -> float:
    return _LABELS + _COLUMN * len(COLUMNS) + 30


def _header() -> str:
    parts = [
        pages.text(_column_x(0) - 30, 18, "components of IVCS", class_="group"),
        pages.text(_column_x(IN_IVCS) - 30, 18, "diagnostic", class_="group"),
        pages.text(_side_x(), 18, "outcome", class_="group"),
    ]
    for index, metric in enumerate(COLUMNS):
        x = _column_x(index)
        head = pages.element(
            "text",
            f"{pages.title(metric.meaning)}{metric.label}",
            x=x,
            y=46,
            class_="head",
            text_anchor="middle",
        )
        parts.append(head)
    parts.append(
        pages.text(_side_x() + 30, 46, "risk response", class_="head", text_anchor="middle")
    )
    parts.append(pages.text(_side_x() + 100, 46, "IVCS", class_="head"))
    meaning = "per label time, the first stage that fails; light: none does"
    head = pages.title(meaning) + "first failures"
    parts.append(pages.element("text", head, x=_side_x() + 226, y=46, class_="head"))
    return "".join(parts)


def _row(cell: CellData, y: float, push: float) -> str:
    middle = y + _ROW / 2
    name = _name(cell)
    name = name if len(name) <= _MOST_LETTERS else name[: _MOST_LETTERS - 1] + "…"
    label = pages.text(100, middle + 4, name, class_="model")
    parts = []
    if cell.score is None:
        reason = "; ".join(cell.facts.reasons) or "no reason given"
        short = reason if len(reason) <= 100 else reason[:97] + "…"
        line = f"{cell.facts.status}: {short}"
        parts.append(pages.text(_LABELS + 10, middle + 4, line, class_="refused"))
    else:
        for index, metric in enumerate(COLUMNS):
            value = getattr(cell.score, metric.name)
            parts.append(_circle(_column_x(index), middle, value, metric.label))
        parts.append(_outcome(cell.score, middle))
    body = pages.title(f"{cell.scenario} / {cell.domain} / {cell.model}") + label
    body += _pushed("".join(parts), push)
    hit = pages.element(
        "rect", x=96, y=y + 1, width=WIDTH + push - 96, height=_ROW - 2, class_="hit"
    )
    return pages.element("a", hit + body, href=f"#{cell.id}", class_="row")


def _circle(x: float, y: float, value: float | None, title: str) -> str:
    if value is None:
        return pages.text(x, y + 4, NULL, class_="value", text_anchor="middle")
    label = pages.text(x + _RADIUS + 5, y + 4, f"{value:.2f}", class_="value")
    tip = pages.title(f"{title} {value:.3f}")
    if value <= 0.0:
        return pages.element("circle", tip, cx=x, cy=y, r=2.5, class_="zero") + label
    radius = _RADIUS * math.sqrt(min(value, 1.0))
    return pages.element("circle", tip, cx=x, cy=y, r=radius, fill=shade(value)) + label


def _outcome(score: CellScore, y: float) -> str:
    x = _side_x()
    response = format_response(score.rsr, score.rl_s)
    kind = "responded" if score.rsr else "failed"
    flag = "*" if score.details.ivcs_nulls else ""
    return "".join(
        (
            pages.element("rect", x=x, y=y - 11, width=60, height=22, rx=11, class_=f"pill {kind}"),
            pages.text(x + 30, y + 4, response, class_=f"pilltext {kind}", text_anchor="middle"),
            pages.element("rect", x=x + 100, y=y - 6, width=70, height=12, class_="track"),
            pages.element(
                "rect", x=x + 100, y=y - 6, width=70 * score.ivcs, height=12,
                fill=shade(score.ivcs),
            ),
            pages.text(x + 177, y + 4, f"{score.ivcs:.3f}{flag}", class_="ivcs"),
            _failures(score, x + 226, y),
        )
    )  # fmt: skip


def _failures(score: CellScore, x: float, y: float) -> str:
    """A square per label time with the number of the first stage that fails (METHOD 6.12)."""
    judgements = score.details.judgements
    step = min(_SQUARE + 2, 150 / len(judgements))
    parts = []
    for index, judgement in enumerate(judgements):
        stage = judgement.first_failure
        left = x + step * index
        tip = pages.title(STAGE_NAMES[stage] if stage else "passes all stages")
        parts.append(
            pages.element(
                "rect", tip, x=left, y=y - _SQUARE / 2, width=max(step - 2, 1.0), height=_SQUARE,
                rx=3, class_="stage fail" if stage else "stage pass",
            )
        )  # fmt: skip
        if stage and step > _SQUARE:
            number = str(STAGES.index(stage) + 1)
            middle = left + (step - 2) / 2
            parts.append(
                pages.text(middle, y + 3.5, number, class_="stagenumber", text_anchor="middle")
            )
    return "".join(parts)


def _legend(y: float) -> str:
    parts = [pages.text(10, y + 4, "Circle area and shade", class_="note")]
    for index, value in enumerate((0.25, 0.5, 0.75, 1.0)):
        x = 166 + 64 * index
        radius = _RADIUS * math.sqrt(value)
        parts.append(pages.element("circle", cx=x, cy=y, r=radius, fill=shade(value)))
        parts.append(pages.text(x + _RADIUS + 3, y + 4, f"{value:g}", class_="note"))
    rest = "S@t: risk response after t seconds · F: none · –: no denominator"
    parts.append(pages.text(_LABELS + 200, y + 4, rest, class_="note"))
    return "".join(parts)


_NAMES = 250.0
_WIDTH = 560.0
_PLOT_SIDE = 210.0

_PLOT_HEAD = 28.0
_POINT_RADIUS = 6.0
_MOST_NAME_LETTERS = 32
SEEING, SPOILT = "as it is", {"black": "black frames", "shuffled": "frames of other times"}
# Answerers that see no frame: what a model must beat to show that it looks.
_BLIND = ("constant_velocity", "copy_history")


def seeing_plot(seeing: Table | None, answerers: Table | None) -> str:
    """The figure as SVG, one row per model; empty where no model was asked blindly."""
    if seeing is None:
        return ""
    models: dict[str, dict[str, tuple[float, float]]] = {}
    for row in _named(seeing):
        own, spoilt = _number(row["ivcs"]), _number(row["ivcs_spoilt"])
        if own is not None and spoilt is not None:
            models.setdefault(str(row["model"]), {})[str(row["condition"])] = (own, spoilt)
    blind = {
        str(row["model"]): value
        for row in _named(answerers)
        if row["model"] in _BLIND and (value := _number(row["ivcs"])) is not None
    }
    if not models:
        return ""
    parts = []
    y = _PLOT_HEAD + _ROW / 2
    for model, found in models.items():
        parts.append(_model(model, found, y))
        y += _ROW
    for name, value in blind.items():
        parts.append(_label(name, y, "blind") + _dot(value, y, "answerer", f"{name} {value:.3f}"))
        y += _ROW
    height = y + 34
    body = _axis(y - _ROW / 2) + "".join(parts) + _seeing_legend(y + 18, bool(blind))
    width = _NAMES + _WIDTH + _PLOT_SIDE
    return pages.element(
        "svg", body, class_="seeing", viewBox=f"0 0 {pages.number(width)} {height}",
        role="img", aria_label="Mean IVCS of each model as it is and with spoilt frames",
    )  # fmt: skip


def _named(table: Table | None) -> list[dict[str, Value]]:
    """The rows by key of their columns."""
    if table is None:
        return []
    keys = [column.key for column in table.columns]
    return [dict(zip(keys, row, strict=True)) for row in table.rows]


def _number(value: Value) -> float | None:
    found = value.value if isinstance(value, Mean) else value
    return found if isinstance(found, float) else None


def _x(value: float) -> float:
    return _NAMES + _WIDTH * min(max(value, 0.0), 1.0)


def _axis(bottom: float) -> str:
    parts = [
        pages.text(_NAMES - 14, _PLOT_HEAD - 10, "mean IVCS", class_="note", text_anchor="end")
    ]
    for k in range(6):
        x = _x(k / 5)
        parts.append(pages.element("line", x1=x, x2=x, y1=_PLOT_HEAD - 6, y2=bottom, class_="rule"))
        parts.append(
            pages.text(x, _PLOT_HEAD - 10, f"{k / 5:g}", class_="note", text_anchor="middle")
        )
    parts.append(
        pages.text(_NAMES + _WIDTH + 24, _PLOT_HEAD - 10, "IVCS owed to seeing", class_="note")
    )
    return "".join(parts)


def _label(name: str, y: float, class_: str = "model") -> str:
    short = name if len(name) <= _MOST_NAME_LETTERS else name[: _MOST_NAME_LETTERS - 1] + "…"
    return pages.text(_NAMES - 14, y + 4, short, class_=class_, text_anchor="end")


def _dot(value: float, y: float, class_: str, tip: str) -> str:
    return pages.element(
        "circle", pages.title(tip), cx=_x(value), cy=y, r=_POINT_RADIUS, class_=class_
    )


def _model(model: str, found: dict[str, tuple[float, float]], y: float) -> str:
    ends = [_x(value) for pair in found.values() for value in pair]
    parts = [
        _label(model, y),
        pages.element("line", x1=min(ends), x2=max(ends), y1=y, y2=y, class_="span"),
    ]
    for condition, (_, spoilt) in found.items():
        tip = f"{model}, {SPOILT.get(condition, condition)}: {spoilt:.3f}"
        parts.append(_dot(spoilt, y, condition, tip))
    # One for each condition: where they were scored on different recordings, they differ.
    for own, _ in found.values():
        parts.append(_dot(own, y, "own", f"{model}, {SEEING}: {own:.3f}"))
    said = ", ".join(f"{condition} {o - s:+.3f}" for condition, (o, s) in found.items())
    parts.append(pages.text(_NAMES + _WIDTH + 24, y + 4, said, class_="note"))
    return "".join(parts)


def _seeing_legend(y: float, blind: bool) -> str:
    entries = [("own", SEEING), *SPOILT.items()]
    if blind:
        entries.append(("answerer", "answerer that sees nothing"))
    parts = []
    x = _NAMES
    for class_, text in entries:
        parts.append(pages.element("circle", cx=x, cy=y, r=_POINT_RADIUS, class_=class_))
        parts.append(pages.text(x + 12, y + 4, text, class_="note"))
        x += 30 + 7 * len(text)
    return "".join(parts)
