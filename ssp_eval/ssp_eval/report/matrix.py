"""The result matrix (METHOD 7.1): cells against component scores, circle area and shade."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_eval.analysis.failure_table import STAGE_NAMES
from ssp_eval.analysis.rows import compared_labels
from ssp_eval.evaluate.admission import UNAUDITED, UNPAIRED
from ssp_eval.report import svg
from ssp_eval.report.load import CellData
from ssp_eval.score import STAGES, CellScore
from ssp_eval.score.show import NULL, format_response

COLUMNS = (
    ("jovr", "JOVR", "valid text and trajectory"),
    ("sem_acc_eff", "SemAcc", "effective accuracy of the semantic slots"),
    ("cia_eff", "CIA", "critical interaction accuracy"),
    ("tqsr", "TQSR", "feasible trajectory with an admissible action"),
    ("act_acc_eff", "ActAcc", "admissible actions in the text (diagnostic)"),
    ("stfr", "STFR", "feasible trajectories (diagnostic)"),
    ("atc_eff", "ATC", "text and trajectory agree (diagnostic)"),
)
IN_IVCS = 4
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
            parts.append(svg.element("rect", x=0, y=y, width=width, height=_BAND, class_="band"))
            title = scenario.replace("_", " ")
            if scenario in apart:
                title += ": not comparable between domains by its labels, in no domain mean"
            parts.append(svg.text(10, y + 20, title, class_="scenario"))
            y += _BAND
        if cell.domain != domain:
            domain = cell.domain
            parts.append(svg.element("line", x1=0, x2=width, y1=y, y2=y, class_="rule"))
            parts.append(svg.text(10, y + _ROW / 2 + 4, domain, class_="domain"))
        parts.append(_row(cell, y, push))
        y += _ROW
    parts.append(svg.element("line", x1=0, x2=width, y1=y, y2=y, class_="rule"))
    parts.append(_legend(y + 26))
    height = y + 52
    marked = {cell.admission for cell in cells} & set(MARKS)
    if marked:
        meaning = " · ".join(f"{MARKS[status]} {status}" for status in sorted(marked))
        text = f"{meaning}: scored, and left out of domain means"
        parts.append(svg.text(10, height, text, class_="note"))
        height += 20
    return svg.element(
        "svg", "".join(parts), class_="matrix", viewBox=f"0 0 {svg.number(width)} {height}",
        role="img", aria_label="Result matrix",
    )  # fmt: skip


def _pushed(content: str, by: float) -> str:
    return svg.element("g", content, transform=f"translate({svg.number(by)} 0)") if by else content


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
        svg.text(_column_x(0) - 30, 18, "components of IVCS", class_="group"),
        svg.text(_column_x(IN_IVCS) - 30, 18, "diagnostic", class_="group"),
        svg.text(_side_x(), 18, "outcome", class_="group"),
    ]
    for index, (_, name, meaning) in enumerate(COLUMNS):
        x = _column_x(index)
        head = svg.element(
            "text", f"{svg.title(meaning)}{name}", x=x, y=46, class_="head", text_anchor="middle"
        )
        parts.append(head)
    parts.append(svg.text(_side_x() + 30, 46, "risk response", class_="head", text_anchor="middle"))
    parts.append(svg.text(_side_x() + 100, 46, "IVCS", class_="head"))
    meaning = "per label time, the first stage that fails; light: none does"
    head = svg.title(meaning) + "first failures"
    parts.append(svg.element("text", head, x=_side_x() + 226, y=46, class_="head"))
    return "".join(parts)


def _row(cell: CellData, y: float, push: float) -> str:
    middle = y + _ROW / 2
    name = _name(cell)
    name = name if len(name) <= _MOST_LETTERS else name[: _MOST_LETTERS - 1] + "…"
    label = svg.text(100, middle + 4, name, class_="model")
    parts = []
    if cell.score is None:
        reason = "; ".join(cell.facts.reasons) or "no reason given"
        short = reason if len(reason) <= 100 else reason[:97] + "…"
        line = f"{cell.facts.status}: {short}"
        parts.append(svg.text(_LABELS + 10, middle + 4, line, class_="refused"))
    else:
        for index, (key, title, _) in enumerate(COLUMNS):
            parts.append(_circle(_column_x(index), middle, getattr(cell.score, key), title))
        parts.append(_outcome(cell.score, middle))
    body = svg.title(f"{cell.scenario} / {cell.domain} / {cell.model}") + label
    body += _pushed("".join(parts), push)
    hit = svg.element("rect", x=96, y=y + 1, width=WIDTH + push - 96, height=_ROW - 2, class_="hit")
    return svg.element("a", hit + body, href=f"#{cell.id}", class_="row")


def _circle(x: float, y: float, value: float | None, title: str) -> str:
    if value is None:
        return svg.text(x, y + 4, NULL, class_="value", text_anchor="middle")
    label = svg.text(x + _RADIUS + 5, y + 4, f"{value:.2f}", class_="value")
    tip = svg.title(f"{title} {value:.3f}")
    if value <= 0.0:
        return svg.element("circle", tip, cx=x, cy=y, r=2.5, class_="zero") + label
    radius = _RADIUS * math.sqrt(min(value, 1.0))
    return svg.element("circle", tip, cx=x, cy=y, r=radius, fill=shade(value)) + label


def _outcome(score: CellScore, y: float) -> str:
    x = _side_x()
    response = format_response(score.rsr, score.rl_s)
    kind = "responded" if score.rsr else "failed"
    flag = "*" if score.details.ivcs_nulls else ""
    return "".join(
        (
            svg.element("rect", x=x, y=y - 11, width=60, height=22, rx=11, class_=f"pill {kind}"),
            svg.text(x + 30, y + 4, response, class_=f"pilltext {kind}", text_anchor="middle"),
            svg.element("rect", x=x + 100, y=y - 6, width=70, height=12, class_="track"),
            svg.element(
                "rect", x=x + 100, y=y - 6, width=70 * score.ivcs, height=12,
                fill=shade(score.ivcs),
            ),
            svg.text(x + 177, y + 4, f"{score.ivcs:.3f}{flag}", class_="ivcs"),
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
        tip = svg.title(STAGE_NAMES[stage] if stage else "passes all stages")
        parts.append(
            svg.element(
                "rect", tip, x=left, y=y - _SQUARE / 2, width=max(step - 2, 1.0), height=_SQUARE,
                rx=3, class_="stage fail" if stage else "stage pass",
            )
        )  # fmt: skip
        if stage and step > _SQUARE:
            number = str(STAGES.index(stage) + 1)
            middle = left + (step - 2) / 2
            parts.append(
                svg.text(middle, y + 3.5, number, class_="stagenumber", text_anchor="middle")
            )
    return "".join(parts)


def _legend(y: float) -> str:
    parts = [svg.text(10, y + 4, "Circle area and shade", class_="note")]
    for index, value in enumerate((0.25, 0.5, 0.75, 1.0)):
        x = 166 + 64 * index
        radius = _RADIUS * math.sqrt(value)
        parts.append(svg.element("circle", cx=x, cy=y, r=radius, fill=shade(value)))
        parts.append(svg.text(x + _RADIUS + 3, y + 4, f"{value:g}", class_="note"))
    rest = "S@t: risk response after t seconds · F: none · –: no denominator"
    parts.append(svg.text(_LABELS + 200, y + 4, rest, class_="note"))
    return "".join(parts)
