"""Legends in a line above a plot, in as many lines as the names need."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from matplotlib.patches import Rectangle

from ssp_eval.figures.style import INK, Look, Sheet, fitted, text_width_in

# The mark of bars; only it can show their hatch.
SQUARE = "s"
_LINE_IN, _BOX_IN = 0.15, 0.09
_LEFT_IN = 0.12


def _places(texts: Sequence[str], width_in: float) -> Iterator[tuple[float, int, str]]:
    """Where each entry's mark stands, in which line, and its text."""
    x, line = _LEFT_IN, 0
    for name in texts:
        text = fitted(name, width_in - 0.4)
        needed = 0.08 + text_width_in(text)
        if x > _LEFT_IN and x + needed > width_in - 0.05:
            x, line = _LEFT_IN, line + 1
        yield x, line, text
        x += needed + 0.18


def legend_height_in(texts: Sequence[str], width_in: float) -> float:
    """Height that mark_legend takes for these names."""
    return _LINE_IN * (1 + max((line for _, line, _ in _places(texts, width_in)), default=0)) + 0.06


def mark_legend(sheet: Sheet, looks: Mapping[str, Look], top_in: float) -> None:
    """Marks with their names.

    Args:
        sheet: to draw on.
        looks: by name, in order.
        top_in: middle of the first line.
    """
    page = sheet.page()
    for (x, line, text), look in zip(
        _places(list(looks), sheet.width_in), looks.values(), strict=True
    ):
        y = top_in + line * _LINE_IN
        if look.hatch and look.marker == SQUARE:
            page.add_patch(
                Rectangle(
                    (x - _BOX_IN / 2, y - _BOX_IN / 2), _BOX_IN, _BOX_IN, facecolor=look.colour,
                    edgecolor=INK, linewidth=0.5, hatch=look.hatch,
                )
            )  # fmt: skip
        else:
            page.plot(
                [x], [y], look.marker, color=look.colour, markeredgecolor=INK, markeredgewidth=0.5
            )
        page.text(x + 0.08, y, text, va="center_baseline")
