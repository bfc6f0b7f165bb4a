"""The responses of an audit as a section of its page: verdicts, curves in corridors, causes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ssp_core.geometry import FloatArray
from ssp_core.templates import templates
from ssp_eval import pages
from ssp_eval.data.response import CurveEntry, PairEntry, ResponseEntry
from ssp_eval.response.iso18571 import INNER, OUTER

_HERE = Path(__file__).parent
STYLE = _HERE / "style.css"
_WIDTH, _HEIGHT = 560.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 12.0, 12.0, 40.0
_TICKS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_MOST_TICKS = 12
# A line of more points can't be told from one of so many.
_POINTS = 560


def section(response: ResponseEntry) -> Markup:
    """Return the section as HTML."""
    environment = templates(_HERE)
    # Without the sign of a zero.
    environment.filters["signed"] = lambda value: f"{value:+z.2f}"
    return Markup(
        environment.get_template("response.html.j2").render(
            response=response,
            pairs=[(pair, Markup(_plot(response, pair))) for pair in response.pairs],
            limits=_limits(response),
        )
    )


def _limits(response: ResponseEntry) -> list[tuple[str, str, Any]]:
    limits = [
        (name.replace("_", " ").replace("ttc", "TTC"), getattr(response.limits, name))
        for name in ("rating", "ttc_at_braking", "remaining_distance", "impact_speed")
    ]
    return [(name, "at least" if name == "rating" else "at most", limit) for name, limit in limits]


def _plot(response: ResponseEntry, pair: PairEntry) -> str:
    """Return the drawing of a rated pair; empty where there is none."""
    curves = [response.curves.get(name) for name in (pair.reference, pair.comparison)]
    if pair.rating is None or curves[0] is None or curves[1] is None:
        return ""
    begin = pair.braking_s or (curves[0].braking_s, curves[1].braking_s)
    return curve_plot(
        (pair.reference, _from(curves[0], begin[0])), (pair.comparison, _from(curves[1], begin[1]))
    )


def _from(curve: CurveEntry, braking_s: float) -> CurveEntry:
    """Return the same curve on the time from another start of the braking."""
    from_s = curve.from_s + curve.braking_s - braking_s
    return curve.model_copy(update={"braking_s": braking_s, "from_s": from_s})


def curve_plot(reference: tuple[str, CurveEntry], comparison: tuple[str, CurveEntry]) -> str:
    """Return both accelerations, aligned at the braking, with the reference's corridors, as SVG.

    Args:
        reference: domain and curve.
        comparison: the same; only the stretch that both have is drawn.
    """
    step_s, both = reference[1].step_s, (reference, comparison)
    own_s = [c.from_s + c.step_s * np.arange(len(c.acceleration_mps2)) for _, c in both]
    first_s, last_s = max(t[0] for t in own_s), min(t[-1] for t in own_s)
    t_s: FloatArray = np.arange(first_s, last_s + step_s / 2, step_s)
    values_of = {
        name: np.interp(t_s, times_s, curve.acceleration_mps2)
        for times_s, (name, curve) in zip(own_s, both, strict=True)
    }
    n = len(t_s)
    indices = np.unique(np.linspace(0, n - 1, min(n, _POINTS)).round().astype(int))
    base = values_of[reference[0]][:n]
    norm = float(np.abs(base).max())
    low = min(float((base - OUTER * norm).min()), *(float(c[:n].min()) for c in values_of.values()))
    high = max(
        float((base + OUTER * norm).max()), *(float(c[:n].max()) for c in values_of.values())
    )

    def x(time_s: FloatArray | float) -> Any:
        share = (np.asarray(time_s) - t_s[0]) / (t_s[-1] - t_s[0])
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * share

    def y(value: FloatArray | float) -> Any:
        share = (high - np.asarray(value)) / (high - low)
        return _TOP + (_HEIGHT - _TOP - _BOTTOM) * share

    def line(values: FloatArray) -> list[tuple[float, float]]:
        return list(zip(x(t_s[indices]).tolist(), y(values[:n][indices]).tolist(), strict=True))

    def band(share: float, class_: str, words: str) -> str:
        outline = [*line(base + share * norm), *line(base - share * norm)[::-1]]
        tooltip = pages.title(f"{words} corridor, ±{share * norm:.2f} m/s²")
        return pages.element("polygon", tooltip, points=pages.points(outline), class_=class_)

    parts = [
        *_axes(t_s, (low, high), x, y),
        band(OUTER, "outer", "outer"),
        band(INNER, "inner", "inner"),
        pages.element("line", x1=x(0.0), x2=x(0.0), y1=_TOP, y2=_HEIGHT - _BOTTOM, class_="zero"),
    ]
    for (name, values), role in zip(values_of.items(), ("reference", "comparison"), strict=True):
        tooltip = pages.title(f"{name}, {role}")
        parts.append(
            pages.element("polyline", tooltip, points=pages.points(line(values)), class_=role)
        )
    title = f"Acceleration of {comparison[0]} against {reference[0]}"
    return pages.element(
        "svg",
        pages.title(title) + "".join(parts),
        class_="response",
        viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}",
        role="img",
        aria_label=title,
    )


def _axes(
    t_s: FloatArray,
    span_mps2: tuple[float, float],
    x: Callable[[float], Any],
    y: Callable[[float], Any],
) -> list[str]:
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    parts = []
    for value in range(int(np.ceil(span_mps2[0] / 2.0)) * 2, int(span_mps2[1]) + 1, 2):
        parts += [
            pages.element("line", x1=_LEFT, x2=right, y1=y(value), y2=y(value), class_="grid"),
            pages.text(_LEFT - 8, float(y(value)) + 4, f"{value:g}", text_anchor="end"),
        ]
    length_s = float(t_s[-1] - t_s[0])
    step_s = next((s for s in _TICKS_S if length_s / s <= _MOST_TICKS), _TICKS_S[-1])
    for k in range(int(np.ceil(t_s[0] / step_s)), int(np.floor(t_s[-1] / step_s)) + 1):
        at = float(x(k * step_s))
        parts += [
            pages.element("line", x1=at, x2=at, y1=bottom, y2=bottom + 5, class_="tick"),
            pages.text(at, bottom + 18, f"{k * step_s:g}", text_anchor="middle"),
        ]
    parts.append(
        pages.text(
            (_LEFT + right) / 2,
            _HEIGHT - 4,
            "s from the start of the braking",
            text_anchor="middle",
        )
    )
    middle = (_TOP + bottom) / 2
    parts.append(
        pages.text(12, middle, "m/s²", text_anchor="middle", transform=f"rotate(-90 12 {middle:g})")
    )
    return parts
