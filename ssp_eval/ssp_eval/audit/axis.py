"""The phases of three recordings on one axis of φ (METHOD 4), as SVG."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ssp_eval.audit.model import RecordingEntry
from ssp_eval.recordings.properties import EVENT_PHASES
from ssp_eval.report import svg

_LEFT, _RIGHT, _TOP = 110.0, 210.0, 34.0
_ROW, _BAR = 46.0, 20.0
WIDTH = 1160.0

# From φ to a position in the picture.
Scale = Callable[[float], float]


def phase_axis(recordings: Sequence[RecordingEntry]) -> str:
    """One bar per recording from the clip's start to its end; lines mark Synthetic's events."""
    length = WIDTH - _LEFT - _RIGHT
    height = _TOP + _ROW * len(recordings) + 26.0

    def x(phi: float) -> float:
        return _LEFT + length * phi

    parts = [_ticks(x, height)]
    reference = recordings[0].phases.phi
    for name, phi in reference.items():
        line = svg.element(
            "line", svg.title(f"{name} in synthetic, φ {phi:.3f}"), x1=x(phi), x2=x(phi),
            y1=_TOP - 6.0, y2=height - 24.0, class_="guide",
        )  # fmt: skip
        parts.append(line)
    for index, recording in enumerate(recordings):
        y = _TOP + _ROW * index
        parts.append(svg.text(_LEFT - 14.0, y + 15.0, recording.domain, text_anchor="end"))
        parts += _bar(recording, y, x)
        right = _LEFT + length + 16.0
        epd = "–" if recording.epd is None else f"{recording.epd:.3f}"
        kpr = "–" if recording.kpr is None else f"{recording.kpr:.2f}"
        parts.append(svg.text(right, y + 15.0, f"EPD {epd}   KPR {kpr}", class_="figure"))
    return svg.element(
        "svg", "".join(parts), class_="phases", viewBox=f"0 0 {svg.number(WIDTH)} {height}",
        role="img", aria_label="Phases on the axis of φ",
    )  # fmt: skip


def _bar(recording: RecordingEntry, y: float, x: Scale) -> list[str]:
    """Coloured from phase to phase as far as they are known, with each start's φ beneath."""
    phases = recording.phases
    known = [(name, phases.phi[name]) for name in EVENT_PHASES if name in phases.phi]
    starts = [("approach", 0.0), *known]
    parts = [
        svg.element("rect", x=x(0.0), y=y, width=x(1.0) - x(0.0), height=_BAR, class_="bar unknown")
    ]
    for index, (name, phi) in enumerate(starts):
        end = starts[index + 1][1] if index + 1 < len(starts) else 1.0
        title = svg.title(f"{recording.domain}: {name} from φ {phi:.3f} to {end:.3f}")
        parts.append(
            svg.element(
                "rect",
                title,
                x=x(phi),
                y=y,
                width=max(0.0, x(end) - x(phi)),
                height=_BAR,
                class_=f"bar {name}",
            )
        )
    for name, half in phases.phi_half_width.items():
        if name in phases.phi:
            low, high = max(0.0, phases.phi[name] - half), min(1.0, phases.phi[name] + half)
            parts.append(
                svg.element(
                    "line",
                    x1=x(low),
                    x2=x(high),
                    y1=y + _BAR / 2,
                    y2=y + _BAR / 2,
                    class_="spread",
                )
            )
    beyond = -100.0
    for _, phi in known:
        # Numbers that would run into each other leave room for the first.
        if x(phi) - beyond > 34.0:
            beyond = x(phi)
            parts.append(
                svg.text(x(phi), y + _BAR + 13.0, f"{phi:.3f}", text_anchor="middle", class_="note")
            )
    return parts


def _ticks(x: Scale, height: float) -> str:
    parts = []
    for k in range(11):
        at = x(k / 10.0)
        parts.append(
            svg.element("line", x1=at, x2=at, y1=height - 24.0, y2=height - 19.0, class_="tick")
        )
        parts.append(svg.text(at, height - 6.0, f"{k / 10:g}", text_anchor="middle", class_="note"))
    parts.append(svg.text(x(1.0) + 16.0, height - 6.0, "φ", class_="note"))
    return "".join(parts)
