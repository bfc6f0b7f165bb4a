"""What a module of figures gives: drawings with captions, or why there is nothing to draw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

from matplotlib.figure import Figure

from ssp_eval.score.show import DISCLAIMER, NULL

UNITS = (
    "JOVR: valid text and trajectory; SemAcc: effective accuracy of the semantic slots; CIA: "
    "critical interaction accuracy; TQSR: feasible trajectory with an admissible action; RSR: risk "
    "response; all from 0 to 1, more is better."
)


Item = TypeVar("Item")


@dataclass(frozen=True)
class Drawing:
    """One figure, made and not yet written.

    Args:
        name: of its files.
        figure: what is drawn.
        caption: what is shown, over what, and what it doesn't say.
    """

    name: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class LeftOut:
    """A figure that these rows don't give, and why."""

    name: str
    reason: str


def caption(*sentences: str, composite: bool = True) -> str:
    """The text that belongs under a figure.

    Args:
        sentences: empty ones are left out.
        composite: IVCS is in the figure.
    """
    parts = [sentence for sentence in sentences if sentence]
    return " ".join([*parts, DISCLAIMER] if composite else parts) + "\n"


def renamed(names: dict[str, str]) -> str:
    """Which names were shortened, as a sentence for the caption."""
    pairs = [f"{shown} is {name}" for name, shown in names.items() if shown != name]
    return f"Shortened names: {'; '.join(pairs)}." if pairs else ""


def page_name(name: str, number: int, pages: int) -> str:
    """The name of a page's files: plain where there is one page only."""
    return name if pages == 1 else f"{name}_{number:0{len(str(pages))}d}"


def pages_of(items: Sequence[Item], most: int) -> list[Sequence[Item]]:
    """The items in as few pages as hold them, of much the same size.

    Args:
        items: in order.
        most: on one page.
    """
    if not items:
        return []
    count = -(-len(items) // most)
    size, more = divmod(len(items), count)
    starts = [k * size + min(k, more) for k in range(count + 1)]
    return [items[a:b] for a, b in pairwise(starts)]


def shown_mean(value: float | None, digits: int = 2) -> str:
    """A mean as a figure writes it."""
    return NULL if value is None else f"{value:.{digits}f}"
