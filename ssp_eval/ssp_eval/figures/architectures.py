"""Two architectures side by side (METHOD 7.4)."""

from __future__ import annotations

from ssp_eval.figures.drawing import UNITS, Drawing, LeftOut, caption
from ssp_eval.figures.named_rows import SCORES, named_rows
from ssp_eval.figures.scores import Scores, counted, listed
from ssp_eval.figures.style import (
    BLUE,
    COLUMN_IN,
    COMPONENT_NAMES,
    FAINT,
    GREY,
    INK,
    ORANGE,
    Look,
    names_in,
    share_axis,
)
from ssp_eval.score.aggregate import Mean, mean


def architectures(scores: Scores) -> Drawing | LeftOut:
    """A dumbbell per score of the two architectures that most models have."""
    name = "foundation_architectures"
    members: dict[str, list[str]] = {}
    for model in scores.by_model:
        if scores.facts[model].architecture:
            members.setdefault(scores.facts[model].architecture, []).append(model)
    order = sorted(members, key=lambda a: (-len(members[a]), a))
    if len(order) < 2:
        return LeftOut(name, "fewer than two architectures are known")
    first, second = sorted(order[:2])
    found: dict[str, dict[str, Mean]] = {
        one: {
            key: mean(c.score[key] for c in scores.cells if c.model in members[one])
            for key in SCORES
        }
        for one in (first, second)
    }
    looks = {first: Look(BLUE, "o", ""), second: Look(ORANGE, "s", "")}
    titles = names_in(looks, 1.9)
    legend = {f"{titles[one]} (models: {len(members[one])})": look for one, look in looks.items()}
    titled = [COMPONENT_NAMES[key] for key in SCORES]
    sheet, axes, _ = named_rows(COLUMN_IN, titled, legend, right_in=0.4, row_in=0.22)
    axes.axhline(len(SCORES) - 1.5, color=FAINT, linewidth=0.6)
    for row, key in enumerate(SCORES):
        ends = {one: found[one][key].value for one in looks}
        known = [value for value in ends.values() if value is not None]
        if len(known) == 2:
            axes.plot(known, [row, row], color=GREY, linewidth=1.4, zorder=2, gid=f"bar-{key}")
            text = f"{known[1] - known[0]:+z.2f}".replace("-", "−")
            axes.text(1.05, row, text, va="center_baseline", clip_on=False)
        for one, value in ends.items():
            if value is not None:
                axes.plot(
                    [value], [row], looks[one].marker, color=looks[one].colour, clip_on=False,
                    markeredgecolor=INK, markeredgewidth=0.4, zorder=3, gid=f"end-{key}-{one}",
                )  # fmt: skip
    share_axis(axes, "score, mean over cells")
    counts = "; ".join(
        f"{one}: {counted(found[one]['ivcs'].n, 'cell')} of {listed(members[one])}" for one in looks
    )
    return Drawing(
        name,
        sheet.figure,
        caption(
            f"Two architectures: unweighted means over all cells of their models ({counts}); the "
            f"number at the right is {second} minus {first}.",
            f"Architectures with fewer models, not shown: {listed(order[2:])}."
            if order[2:]
            else "",
            "The models differ in more than their architecture, and so the difference isn't its "
            "effect alone.",
            scores.left_out,
            UNITS,
        ),
    )
