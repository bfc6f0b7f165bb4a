"""What seeing is worth, drawn: IVCS of each model as it is, and with spoilt frames."""

from __future__ import annotations

from ssp_eval.analysis.table import Table, Value
from ssp_eval.report import svg
from ssp_eval.score.aggregate import Mean

_NAMES = 250.0
_WIDTH = 560.0
_SIDE = 210.0
_ROW = 34.0
_HEAD = 28.0
_RADIUS = 6.0
_MOST_LETTERS = 32
SEEING, SPOILT = "as it is", {"black": "black frames", "shuffled": "frames of other times"}
# Answerers that see no frame: what a model must beat to show that it looks.
_BLIND = ("constant_velocity", "copy_history")


def seeing_plot(seeing: Table | None, answerers: Table | None) -> str:
    """The figure as SVG, one row per model; empty where no model was asked blindly.

    Args:
        seeing: see control_tables.seeing_table.
        answerers: see control_tables.answerers_table.
    """
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
    y = _HEAD + _ROW / 2
    for model, found in models.items():
        parts.append(_model(model, found, y))
        y += _ROW
    for name, value in blind.items():
        parts.append(_label(name, y, "blind") + _dot(value, y, "answerer", f"{name} {value:.3f}"))
        y += _ROW
    height = y + 34
    body = _axis(y - _ROW / 2) + "".join(parts) + _legend(y + 18, bool(blind))
    return svg.element(
        "svg", body, class_="seeing", viewBox=f"0 0 {svg.number(_NAMES + _WIDTH + _SIDE)} {height}",
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
    parts = [svg.text(_NAMES - 14, _HEAD - 10, "mean IVCS", class_="note", text_anchor="end")]
    for k in range(6):
        x = _x(k / 5)
        parts.append(svg.element("line", x1=x, x2=x, y1=_HEAD - 6, y2=bottom, class_="rule"))
        parts.append(svg.text(x, _HEAD - 10, f"{k / 5:g}", class_="note", text_anchor="middle"))
    parts.append(svg.text(_NAMES + _WIDTH + 24, _HEAD - 10, "IVCS owed to seeing", class_="note"))
    return "".join(parts)


def _label(name: str, y: float, class_: str = "model") -> str:
    short = name if len(name) <= _MOST_LETTERS else name[: _MOST_LETTERS - 1] + "…"
    return svg.text(_NAMES - 14, y + 4, short, class_=class_, text_anchor="end")


def _dot(value: float, y: float, class_: str, tip: str) -> str:
    return svg.element("circle", svg.title(tip), cx=_x(value), cy=y, r=_RADIUS, class_=class_)


def _model(model: str, found: dict[str, tuple[float, float]], y: float) -> str:
    ends = [_x(value) for pair in found.values() for value in pair]
    parts = [
        _label(model, y),
        svg.element("line", x1=min(ends), x2=max(ends), y1=y, y2=y, class_="span"),
    ]
    for condition, (_, spoilt) in found.items():
        tip = f"{model}, {SPOILT.get(condition, condition)}: {spoilt:.3f}"
        parts.append(_dot(spoilt, y, condition, tip))
    # One for each condition: where they were scored on different recordings, they differ.
    for own, _ in found.values():
        parts.append(_dot(own, y, "own", f"{model}, {SEEING}: {own:.3f}"))
    said = ", ".join(f"{condition} {o - s:+.3f}" for condition, (o, s) in found.items())
    parts.append(svg.text(_NAMES + _WIDTH + 24, y + 4, said, class_="note"))
    return "".join(parts)


def _legend(y: float, blind: bool) -> str:
    entries = [("own", SEEING), *SPOILT.items()]
    if blind:
        entries.append(("answerer", "answerer that sees nothing"))
    parts = []
    x = _NAMES
    for class_, text in entries:
        parts.append(svg.element("circle", cx=x, cy=y, r=_RADIUS, class_=class_))
        parts.append(svg.text(x + 12, y + 4, text, class_="note"))
        x += 30 + 7 * len(text)
    return "".join(parts)
