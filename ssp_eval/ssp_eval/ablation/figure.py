"""The figure of an ablation: what each arm keeps of the event."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_eval.ablation.campaign import ARMS, Realisation
from ssp_eval.ablation.tables import FIELD_SHARES, SHARES, share_of_arm
from ssp_eval.figures.style import (
    COLUMN_IN,
    FAINT,
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
_DRAWN = (SHARES[0], *FIELD_SHARES, SHARES[1], SHARES[3])


def arms_figure(event: str, realisations: Sequence[Realisation]) -> Drawing:
    """Draw the shares of realisations that keep each part of the event, by arm."""
    looks: dict[str, Look] = dict(zip(ARMS, LOOKS, strict=False))
    sheet, axes, _ = named_rows(
        COLUMN_IN, [measure.title for measure in _DRAWN], looks, row_in=_ROW_IN
    )
    share_axis(axes, "share of realisations")
    for row, measure in enumerate(_DRAWN):
        if row:
            axes.axhline(row - 0.5, color=FAINT, linewidth=0.5)
        for lane, arm in enumerate(ARMS):
            found = share_of_arm(realisations, arm, measure)
            y = row + (lane - 1) * _LANE
            ends = found.interval
            if ends.low is not None and ends.high is not None:
                axes.plot([ends.low, ends.high], [y, y], color=looks[arm].colour, linewidth=0.9)
            mark(axes, (found.value, y), looks[arm], gid=f"{measure.key}-{arm}")
    n = sum(one.arm == ARMS[0] for one in realisations)
    places = len({one.place for one in realisations})
    text = caption(
        f"What each arm keeps of {event}: shares of {n} realisations on {places} places.",
        "Lines: Wilson's interval of 95 %, for these places.",
        "A realisation without a run keeps nothing.",
        composite=False,
    )
    return Drawing("arms", sheet.figure, text)
