"""Differences of the models to a reference (METHOD 7.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ssp_eval.figures.drawing import UNITS, Drawing, LeftOut, caption, page_name, renamed
from ssp_eval.figures.named_rows import ROW_IN, SCORES, name_rows, row_pages
from ssp_eval.figures.scores import Scores, listed
from ssp_eval.figures.style import (
    BLUE,
    COMPONENT_NAMES,
    FAINT,
    INK,
    PAGE_IN,
    RED,
    Sheet,
    names_in,
    widest_in,
)
from ssp_eval.score.aggregate import BY_MODEL, Cell, means, relative_difference

# Ends of the axes that all panels share.
_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0)


def differences(scores: Scores, reference: str | None) -> Iterator[Drawing | LeftOut]:
    """Mean scores of each model less those of a reference, over the cells that both have.

    Args:
        scores: what is shown.
        reference: the model that others are compared to; None: the best by IVCS.
    """
    name = "models_difference"
    if len(scores.by_model) < 2:
        yield LeftOut(name, "a difference needs two models")
        return
    chosen = reference is not None
    base = reference if reference is not None else next(iter(scores.by_model))
    others = [model for model in scores.by_model if model != base]
    pairs: dict[str, tuple[list[Cell], list[Cell]]] = {
        model: _shared(scores.cells, model, base) for model in others
    }
    compared = [model for model in others if pairs[model][0]]
    if not compared:
        yield LeftOut(name, f"no model has a scenario and domain in common with {base}")
        return
    names = names_in([*compared, base], 1.6)
    pages = row_pages(compared)
    for number, members in enumerate(pages, start=1):
        sheet = _difference_panels({m: pairs[m] for m in members}, names)
        apart = [model for model in others if model not in compared]
        counts = sorted({len(pairs[m][0]) for m in members})
        yield Drawing(
            page_name(name, number, len(pages)),
            sheet.figure,
            caption(
                f"Differences to the reference {base}"
                + (" (as chosen)" if chosen else " (the best by IVCS; --reference names another)")
                + ": mean score of a model minus the reference's, over the scenarios and domains "
                f"that both have ({', '.join(map(str, counts))} per model); at the right the "
                "difference of IVCS relative to the reference's. Filled bars are gains, hatched "
                "ones losses, – is a score without denominator.",
                f"Nothing in common with it: {listed(apart)}." if apart else "",
                scores.left_out,
                UNITS,
                renamed({m: names[m] for m in (*members, base)}),
            ),
        )


def _shared(cells: Sequence[Cell], model: str, base: str) -> tuple[list[Cell], list[Cell]]:
    """The cells of two models in the scenarios and domains that both have."""
    by_model: dict[str, dict[tuple[str, str], Cell]] = {model: {}, base: {}}
    for cell in cells:
        if cell.model in by_model:
            by_model[cell.model][(cell.scenario, cell.domain)] = cell
    keys = sorted(by_model[model].keys() & by_model[base].keys())
    return [by_model[model][key] for key in keys], [by_model[base][key] for key in keys]


def _difference_panels(
    pairs: Mapping[str, tuple[list[Cell], list[Cell]]], names: dict[str, str]
) -> Sheet:
    found = {}
    for model, (own, others) in pairs.items():
        mine = next(iter(means(own, BY_MODEL).values()))
        theirs = next(iter(means(others, BY_MODEL).values()))
        found[model] = {key: (mine[key].value, theirs[key].value) for key in SCORES}
    apart = {
        model: {k: None if a is None or b is None else a - b for k, (a, b) in row.items()}
        for model, row in found.items()
    }
    most = max((abs(v) for row in apart.values() for v in row.values() if v is not None), default=0)
    limit = next(step for step in _LIMITS if most <= step + 1e-9)
    left_in, right_in, head_in = widest_in(names[m] for m in pairs) + 0.15, 0.55, 0.24
    room_in = PAGE_IN - left_in - right_in
    panel_in = (room_in - 0.14 * (len(SCORES) - 1)) / len(SCORES)
    height_in = ROW_IN * len(pairs)
    sheet = Sheet(PAGE_IN, head_in + height_in + 0.3)
    for column, key in enumerate(SCORES):
        axes = sheet.axes(left_in + column * (panel_in + 0.14), head_in, panel_in, height_in)
        axes.set_xlim(-limit, limit)
        name_rows(axes, [names[m] if column == 0 else "" for m in pairs])
        axes.set_title(COMPONENT_NAMES[key], pad=3, size=7.0)
        axes.set_xticks([-limit, 0.0, limit], [f"−{limit:g}", "0", f"+{limit:g}"])
        ends = axes.get_xticklabels()
        ends[0].set_horizontalalignment("left")
        ends[-1].set_horizontalalignment("right")
        axes.spines["left"].set_visible(False)
        axes.axvline(0.0, color=INK, linewidth=0.7)
        for row, model in enumerate(pairs):
            axes.axhline(row, color=FAINT, linewidth=0.4, zorder=0)
            value = apart[model][key]
            if value is None:
                axes.text(0.0, row, " –", va="center_baseline")
                continue
            gain = value >= 0.0
            axes.barh(
                row, value, 0.6, color=BLUE if gain else "white", edgecolor=BLUE if gain else RED,
                linewidth=0.6, hatch="" if gain else "//////", gid=f"bar-{model}-{key}",
            )  # fmt: skip
    page = sheet.page()
    page.text(PAGE_IN - 0.05, head_in - 0.07, "rel. IVCS", ha="right")
    for row, model in enumerate(pairs):
        share = relative_difference(*found[model]["ivcs"])
        text = "–" if share is None else f"{share:+z.0%}".replace("-", "−").replace("%", " %")
        page.text(
            PAGE_IN - 0.05, head_in + ROW_IN * (row + 0.5), text, ha="right", va="center_baseline"
        )
    return sheet
