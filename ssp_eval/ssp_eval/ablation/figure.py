"""The figure of an ablation: what each arm keeps of the event."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ssp_eval.ablation.campaign import ARMS, Realisation
from ssp_eval.ablation.tables import FIELD_SHARES, SHARES, share_of_arm
from ssp_eval.figures.style import (
    COLUMN_IN,
    FAINT,
    INK,
    LOOKS,
    Drawing,
    Look,
    caption,
    mark,
    named_rows,
    share_axis,
)

_LANE = 0.26
_ROW_IN = 0.34
# Of all realisations, and below them of the runs that an arm made.
_OF_ALL = tuple(one for one in SHARES if one.key != "off_spec")
_DRAWN = (*_OF_ALL, *FIELD_SHARES)


def figures(event: str, realisations: Sequence[Realisation]) -> Iterator[Drawing]:
    """Yield the figures of an ablation, each made when it is asked for."""
    yield arms_figure(event, realisations)


def arms_figure(event: str, realisations: Sequence[Realisation]) -> Drawing:
    """Draw the shares of realisations that keep each part of the event, by arm."""
    looks: dict[str, Look] = dict(zip(ARMS, LOOKS, strict=False))
    sheet, axes, _ = named_rows(
        COLUMN_IN, [measure.title for measure in _DRAWN], looks, row_in=_ROW_IN
    )
    share_axis(axes, "share")
    for row, measure in enumerate(_DRAWN):
        if row:
            between = row == len(_OF_ALL)
            axes.axhline(row - 0.5, color=INK if between else FAINT, linewidth=0.5)
        for lane, arm in enumerate(ARMS):
            share = share_of_arm(realisations, arm, measure)
            y = row + (lane - 1) * _LANE
            ends = share.interval
            if ends.low is not None and ends.high is not None:
                axes.plot([ends.low, ends.high], [y, y], color=looks[arm].colour, linewidth=0.9)
            if share.value is not None:
                mark(axes, (share.value, y), looks[arm], gid=f"{measure.key}-{arm}")
    n = sum(one.arm == ARMS[0] for one in realisations)
    places = len({one.place for one in realisations})
    text = caption(
        f"What each arm keeps of {event}, on {places} places.",
        f"Above the line: shares of {n} realisations; below it: of the runs that an arm made.",
        "Event lost: the arm made a run, and it isn't admitted.",
        "Thin lines: Wilson's interval of 95 %, for these places.",
        composite=False,
    )
    return Drawing("arms", sheet.figure, text)
