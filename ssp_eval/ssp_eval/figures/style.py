"""How figures look: sizes of a two-column paper, fonts, colours, shapes and hatches."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.textpath import text_to_path

COLUMN_IN, PAGE_IN, MOST_HEIGHT_IN = 3.4, 7.0, 9.0
SMALL_PT, TEXT_PT = 7.0, 8.0
LINE_IN = 0.14  # from one line of small text to the next
# Room for names beside a plot of this width.
NAMES_IN = {COLUMN_IN: 1.15, PAGE_IN: 2.9}
# It comes with matplotlib, so that the same rows give the same figure on every machine.
FONT = "DejaVu Sans"

# The colours of Okabe and Ito, which people with any usual colour vision tell apart.
BLUE, SKY, GREEN, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#F0E442"
ORANGE, RED, PURPLE = "#E69F00", "#D55E00", "#CC79A7"
INK, GREY, FAINT = "#1a1a1a", "#6b6b6b", "#d9d9d9"


@dataclass(frozen=True)
class Look:
    """How one of several things is told from the others, in colour and without."""

    colour: str
    marker: str
    hatch: str


# Dark, light and between, so that a line without a mark is told apart in grey too.
DOMAIN_LOOKS = {
    "synthetic": Look("#004a75", "o", ""),
    "simulation": Look("#f0b030", "^", "//"),
    "physical": Look(GREEN, "s", ".."),
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
    "jovr": Look("#bdbdbd", "o", ""),
    "sem_acc_eff": Look(BLUE, "^", ""),
    "cia_eff": Look(SKY, "s", "////"),
    "tqsr": Look(ORANGE, "D", "\\\\\\\\"),
    "rsr": Look(YELLOW, "v", "...."),
}
COMPONENT_NAMES = {
    "jovr": "JOVR",
    "sem_acc_eff": "SemAcc",
    "cia_eff": "CIA",
    "tqsr": "TQSR",
    "rsr": "RSR",
    "ivcs": "IVCS",
    "act_acc_eff": "ActAcc",
    "stfr": "STFR",
    "atc_eff": "ATC",
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
    """Our settings, and none of the user's, while figures are made and written."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


class Sheet:
    """A figure that is laid out in inches from its upper left corner.

    Args:
        width_in, height_in: of the whole figure.
    """

    def __init__(self, width_in: float, height_in: float) -> None:
        self.width_in, self.height_in = width_in, height_in
        self.figure = Figure(figsize=(width_in, height_in))
        FigureCanvasAgg(self.figure)

    def axes(self, left_in: float, top_in: float, width_in: float, height_in: float) -> Axes:
        """Axes with this rectangle inside their frame."""
        return self.figure.add_axes(
            (
                left_in / self.width_in,
                1.0 - (top_in + height_in) / self.height_in,
                width_in / self.width_in,
                height_in / self.height_in,
            )
        )

    def page(self) -> Axes:
        """Axes over all of it without frame, in inches from the upper left corner."""
        axes = self.axes(0.0, 0.0, self.width_in, self.height_in)
        axes.set_xlim(0.0, self.width_in)
        axes.set_ylim(self.height_in, 0.0)
        axes.set_axis_off()
        return axes


def share_axis(axes: Axes, name: str) -> None:
    """The horizontal axis of a score from 0 to 1."""
    axes.set_xlim(-0.02, 1.02)
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "0.25", "0.5", "0.75", "1"])
    axes.set_xlabel(name, labelpad=2)
    axes.grid(axis="x")


@lru_cache(maxsize=4096)
def text_width_in(text: str, size_pt: float = SMALL_PT, bold: bool = False) -> float:
    """Width of one line of text, in."""
    font = FontProperties(family=FONT, size=size_pt, weight="bold" if bold else "normal")
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, False)
    return float(width) / 72.0


def widest_in(texts: Iterable[str], size_pt: float = SMALL_PT) -> float:
    """Width of the widest of some lines, in; 0 for none."""
    return max((text_width_in(text, size_pt) for text in texts), default=0.0)


@lru_cache(maxsize=1)
def _drawable() -> frozenset[int]:
    path = findfont(FontProperties(family=FONT), fallback_to_default=False)
    return frozenset(get_font(path).get_charmap())


def drawable(text: str) -> str:
    """The text on one line, with ``?`` for characters that the font lacks."""
    known = _drawable()
    return "".join(c if c.isprintable() and ord(c) in known else "?" for c in text)


def row_width_in(names: Iterable[str]) -> float:
    """Width of a figure with a name per row: one column, or both where names are long."""
    fits = widest_in(map(drawable, names)) <= NAMES_IN[COLUMN_IN]
    return COLUMN_IN if fits else PAGE_IN


def fitted(text: str, most_in: float, size_pt: float = SMALL_PT, head: float = 0.5) -> str:
    """The text, cut where it is wider than this; what is cut shows as an ellipsis.

    Args:
        text: one line.
        most_in: width.
        size_pt: of the font.
        head: how much of what is kept is kept of the beginning.
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


def names_in(names: Iterable[str], most_in: float) -> dict[str, str]:
    """How names are shown within a width: cut where they must be, and still told apart."""
    names = list(names)
    for head in (0.5, 0.75, 1.0, 0.25):
        shown = {name: fitted(name, most_in, head=head) for name in names}
        if len(set(shown.values())) == len(names):
            return shown
    used: set[str] = set()
    for name in names:
        text, number = fitted(name, most_in), 2
        while text in used:
            mark = f" ({number})"
            text = fitted(name, most_in - text_width_in(mark)) + mark
            number += 1
        used.add(text)
        shown[name] = text
    return shown
