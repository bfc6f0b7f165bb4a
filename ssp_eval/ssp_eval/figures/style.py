"""The style of figures: sizes, fonts, colours, legends, rows with names, captions."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.patches import Rectangle
from matplotlib.textpath import text_to_path

from ssp_eval.score.cli import DISCLAIMER, NULL
from ssp_eval.score.metrics import BY_NAME, COMPONENTS

COLUMN_IN, PAGE_IN, MOST_HEIGHT_IN = 3.4, 7.0, 9.0
SMALL_PT, TEXT_PT = 7.0, 8.0
LINE_IN = 0.14  # from one line of small text to the next
ROW_IN = 0.17
_MOST_ROWS = 46
# Room for names beside a plot of this width.
NAMES_IN = {COLUMN_IN: 1.15, PAGE_IN: 2.9}
# It comes with matplotlib, so that the same rows give the same figure on every machine.
FONT = "DejaVu Sans"

# The colours of Okabe and Ito, which people with any usual colour vision tell apart.
BLUE, SKY, GREEN, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#F0E442"
ORANGE, RED, PURPLE = "#E69F00", "#D55E00", "#CC79A7"
INK, GREY, FAINT = "#1a1a1a", "#6b6b6b", "#d9d9d9"


# The mark of bars; only it can show their hatch.
SQUARE = "s"


@dataclass(frozen=True)
class Look:
    """The look that tells one of several series from the others, in colour and without."""

    colour: str
    marker: str
    hatch: str


# Dark, light and between, so that a line without a mark is told apart in grey too.
DOMAIN_LOOKS = {
    "synthetic": Look("#004a75", "o", ""),
    "simulation": Look("#f0b030", "^", ""),
    "physical": Look(GREEN, SQUARE, ""),
}
# For scenarios and architectures, in the order of their names.
LOOKS = (
    Look(BLUE, "o", ""),
    Look(ORANGE, "^", "////"),
    Look(GREEN, "s", "...."),
    Look(PURPLE, "v", "xxxx"),
    Look(SKY, "P", "\\\\\\\\"),
    Look(RED, "X", "||||"),
    Look(YELLOW, "*", "----"),
)
# What IVCS is made of, from light to dark and back so that neighbours differ in grey too.
COMPONENT_LOOKS = {
    "jovr": Look("#bdbdbd", SQUARE, ""),
    "sem_acc_eff": Look(BLUE, SQUARE, ""),
    "cia_eff": Look(SKY, SQUARE, "////"),
    "tqsr": Look(ORANGE, SQUARE, "\\\\\\\\"),
    "rsr": Look(YELLOW, SQUARE, "...."),
}

_SETTINGS: dict[Any, Any] = {
    "font.family": [FONT],
    "font.size": SMALL_PT,
    "axes.titlesize": TEXT_PT,
    "axes.labelsize": SMALL_PT,
    "axes.linewidth": 0.6,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "text.color": INK,
    # A dollar in a model's name is a dollar.
    "text.parse_math": False,
    # Widths that don't depend on the resolution.
    "text.hinting": "no_hinting",
    "xtick.labelsize": SMALL_PT,
    "ytick.labelsize": SMALL_PT,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": SMALL_PT,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "lines.markersize": 5.0,
    # So that a border of a dashed line has the line's dashes.
    "lines.scale_dashes": False,
    "hatch.linewidth": 0.5,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    # Text stays text, and the same figure the same bytes.
    "svg.fonttype": "none",
    "svg.hashsalt": "ssp",
    "pdf.fonttype": 42,
    "image.composite_image": False,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Apply our settings, and none of the user's, while figures are made and written."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


class Sheet:
    """A figure that is laid out in inches from its upper left corner."""

    def __init__(self, width_in: float, height_in: float) -> None:
        self.width_in, self.height_in = width_in, height_in
        self.figure = Figure(figsize=(width_in, height_in))
        FigureCanvasAgg(self.figure)

    def axes(self, left_in: float, top_in: float, width_in: float, height_in: float) -> Axes:
        """Return axes with this rectangle inside their frame."""
        return self.figure.add_axes(
            (
                left_in / self.width_in,
                1.0 - (top_in + height_in) / self.height_in,
                width_in / self.width_in,
                height_in / self.height_in,
            )
        )

    def page(self) -> Axes:
        """Return axes over the whole figure without frame, in inches from the upper left corner."""
        axes = self.axes(0.0, 0.0, self.width_in, self.height_in)
        axes.set_xlim(0.0, self.width_in)
        axes.set_ylim(self.height_in, 0.0)
        axes.set_axis_off()
        return axes


def share_axis(axes: Axes, name: str) -> None:
    """Set up the horizontal axis of a score from 0 to 1."""
    axes.set_xlim(-0.02, 1.02)
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "0.25", "0.5", "0.75", "1"])
    axes.set_xlabel(name, labelpad=2)
    axes.grid(axis="x")


@lru_cache(maxsize=4096)
def text_width_in(text: str, size_pt: float = SMALL_PT, bold: bool = False) -> float:
    """Return the width of one line of text, in."""
    font = FontProperties(family=FONT, size=size_pt, weight="bold" if bold else "normal")
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, False)
    return float(width) / 72.0


def widest_in(texts: Iterable[str], size_pt: float = SMALL_PT) -> float:
    """Return the width of the widest of some lines, in; 0 for none."""
    return max((text_width_in(text, size_pt) for text in texts), default=0.0)


@lru_cache(maxsize=1)
def _drawable() -> frozenset[int]:
    path = findfont(FontProperties(family=FONT), fallback_to_default=False)
    return frozenset(get_font(path).get_charmap())


def drawable(text: str) -> str:
    """Return the text on one line, with ``?`` for characters that the font lacks."""
    code_points = _drawable()
    return "".join(c if c.isprintable() and ord(c) in code_points else "?" for c in text)


def row_width_in(names: Iterable[str]) -> float:
    """Return width of a figure with a name per row: one column, or both where names are long."""
    fits = widest_in(map(drawable, names)) <= NAMES_IN[COLUMN_IN]
    return COLUMN_IN if fits else PAGE_IN


def fitted(text: str, most_in: float, size_pt: float = SMALL_PT, head: float = 1.0) -> str:
    """Return the text, cut where it is too wide; what is cut shows as an ellipsis.

    Args:
        text: to be shown.
        most_in: largest width, in.
        size_pt: size of the letters, pt.
        head: share of the kept letters that are taken from the beginning.
    """
    text = drawable(text)
    if text_width_in(text, size_pt) <= most_in:
        return text

    def cut(keep: int) -> str:
        first = round(keep * head)
        return text[:first] + "…" + text[len(text) - (keep - first) :]

    # The most characters that fit; a longer cut is a wider one.
    keep = bisect_right(range(len(text)), most_in, key=lambda k: text_width_in(cut(k), size_pt))
    return cut(max(keep - 1, 0))


def _with_condition(name: str, most_in: float) -> str:
    model, plus, condition = name.rpartition("+")
    rest = drawable(f"+{condition}")
    room_in = most_in - text_width_in(rest)
    if not plus or room_in < text_width_in(f"{model[:3]}…"):
        return fitted(name, most_in)
    return fitted(model, room_in) + rest


def names_in(names: Iterable[str], most_in: float) -> dict[str, str]:
    """Shorten names to a width so that they still differ.

    The name of a control, ``MODEL+CONDITION``, keeps its condition where that leaves room for the
    beginning of the model's name. Other names lose their end, or, where that makes two alike,
    their beginning.
    """
    names = list(names)
    short_names = {name: _with_condition(name, most_in) for name in names}
    if len(set(short_names.values())) == len(names):
        return short_names
    for head in (1.0, 0.0):
        short_names = {name: fitted(name, most_in, head=head) for name in names}
        if len(set(short_names.values())) == len(names):
            return short_names
    used: set[str] = set()
    for name in names:
        text, number = fitted(name, most_in), 2
        while text in used:
            mark = f" ({number})"
            text = fitted(name, most_in - text_width_in(mark)) + mark
            number += 1
        used.add(text)
        short_names[name] = text
    return short_names


_LINE_IN, _BOX_IN = 0.15, 0.09
_LEFT_IN = 0.12


def _places(texts: Sequence[str], width_in: float) -> Iterator[tuple[float, int, str]]:
    """Yield where each entry's mark stands, in which line, and its text."""
    x, line = _LEFT_IN, 0
    for name in texts:
        text = fitted(name, width_in - 0.4)
        needed = 0.08 + text_width_in(text)
        if x > _LEFT_IN and x + needed > width_in - 0.05:
            x, line = _LEFT_IN, line + 1
        yield x, line, text
        x += needed + 0.18


def legend_height_in(texts: Sequence[str], width_in: float) -> float:
    """Return the height that mark_legend takes for these names."""
    return _LINE_IN * (1 + max((line for _, line, _ in _places(texts, width_in)), default=0)) + 0.06


def mark_legend(sheet: Sheet, looks: Mapping[str, Look], top_in: float) -> None:
    """Draw marks with their names.

    Args:
        sheet: that they are drawn on.
        looks: by name, in order.
        top_in: middle of the first line below the sheet's upper border, in.
    """
    page = sheet.page()
    for (x, line, text), look in zip(
        _places(list(looks), sheet.width_in), looks.values(), strict=True
    ):
        y = top_in + line * _LINE_IN
        if look.hatch and look.marker == SQUARE:
            page.add_patch(
                Rectangle(
                    (x - _BOX_IN / 2, y - _BOX_IN / 2),
                    _BOX_IN,
                    _BOX_IN,
                    facecolor=look.colour,
                    edgecolor=INK,
                    linewidth=0.5,
                    hatch=look.hatch,
                )
            )
        else:
            mark(page, (x, y), look, markeredgewidth=0.5)
        page.text(x + 0.08, y, text, va="center_baseline")


def mark(
    axes: Axes, at: tuple[float, float], look: Look, gid: str | None = None, **more: Any
) -> None:
    """Draw one mark with a dark border, over lines, also where it reaches beyond the axes."""
    style: dict[str, Any] = {
        # A stroke is nothing but its border.
        "markeredgecolor": look.colour if look.marker == "|" else INK,
        "markeredgewidth": 0.4,
        "clip_on": False,
        "zorder": 3,
    }
    axes.plot(at[0], at[1], look.marker, color=look.colour, gid=gid, **(style | more))


UNITS = (
    "; ".join(f"{BY_NAME[name].label}: {BY_NAME[name].meaning}" for name in COMPONENTS)
    + "; all from 0 to 1, more is better."
)


Item = TypeVar("Item")


@dataclass(frozen=True)
class Drawing:
    """One figure, made and not yet written.

    Args:
        caption: what is shown, over what, and what it doesn't say.
    """

    name: str
    figure: Figure
    caption: str

    @property
    def title(self) -> str:
        """The first clause of its caption."""
        return re.split(r"[:;.]\s", self.caption)[0]


@dataclass(frozen=True)
class LeftOut:
    """A figure that these rows don't give, and why."""

    name: str
    reason: str


def caption(*sentences: str, composite: bool = True) -> str:
    """Return the text that belongs under a figure.

    Args:
        sentences: empty ones are left out.
        composite: whether the figure shows IVCS, so that the disclaimer is added.
    """
    parts = [sentence for sentence in sentences if sentence]
    return " ".join([*parts, DISCLAIMER] if composite else parts) + "\n"


def renamed(names: dict[str, str]) -> str:
    """Name the shortened names, as a sentence for the caption."""
    pairs = [f"{short_name} is {name}" for name, short_name in names.items() if short_name != name]
    return f"Shortened names: {'; '.join(pairs)}." if pairs else ""


def page_name(name: str, number: int, pages: int) -> str:
    """Return the name of a page's files: plain where there is one page only."""
    return name if pages == 1 else f"{name}_{number:0{len(str(pages))}d}"


def pages_of(
    name: str, items: Sequence[Item], most: int = _MOST_ROWS
) -> Iterator[tuple[str, list[Item]]]:
    """Yield the name of each page's files and its items: few pages, of much the same size."""
    count = -(-len(items) // most)
    for number in range(count):
        size, more = divmod(len(items), count)
        start = number * size + min(number, more)
        page = list(items[start : start + size + (number < more)])
        yield page_name(name, number + 1, count), page


def format_mean(value: float | None, digits: int = 2) -> str:
    """Return a mean as a figure writes it."""
    return NULL if value is None else f"{value:.{digits}f}"


NO_MODEL = "no cell of a model may enter means"


def name_rows(axes: Axes, labels: Sequence[str]) -> None:
    """Make one row per label from top to bottom, with the label at its left."""
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
    """Return a sheet with a row per label under a legend.

    Args:
        width_in: of the sheet, in.
        labels: of the rows, from the top.
        legend: looks by name, in order; empty: no legend.
        right_in: room at the right of the rows.
        row_in: height of a row, in.

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
