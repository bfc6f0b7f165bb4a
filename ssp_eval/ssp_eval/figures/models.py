"""Models (METHOD 7.3): ranges, ranks, profiles, differences to a reference, controls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import median

from matplotlib.axes import Axes

from ssp_eval.figures.ranks import rank_slopes
from ssp_eval.figures.scores import Group, Scores, listed, words
from ssp_eval.figures.style import (
    BLUE,
    FAINT,
    GREY,
    INK,
    LOOKS,
    NAMES_IN,
    NO_MODEL,
    PAGE_IN,
    RED,
    ROW_IN,
    UNITS,
    Drawing,
    LeftOut,
    Look,
    Sheet,
    caption,
    format_mean,
    mark,
    name_rows,
    named_rows,
    names_in,
    pages_of,
    renamed,
    row_width_in,
    share_axis,
    text_width_in,
    widest_in,
)
from ssp_eval.score.aggregate import BY_MODEL, Cell, means, relative_difference
from ssp_eval.score.metrics import COMPONENTS, IVCS_LAST, METRIC_LABELS
from ssp_eval.statistics.constants import CONSTANT, MARK

# Ends of the axes that all panels share.
_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0)


def differences(scores: Scores, reference: str | None) -> Iterator[Drawing | LeftOut]:
    """Yield the mean scores of models less a reference's, over the cells that both have.

    Args:
        scores: of the rows.
        reference: the model that others are compared to; None: the best by IVCS.
    """
    name = "models_difference"
    if len(scores.by_model) < 2:
        yield LeftOut(name, "a difference needs two models")
        return
    has_reference = reference is not None
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
    for page, members in pages_of(name, compared):
        sheet = _difference_panels({m: pairs[m] for m in members}, names)
        apart = [model for model in others if model not in compared]
        counts = sorted({len(pairs[m][0]) for m in members})
        yield Drawing(
            page,
            sheet.figure,
            caption(
                f"Differences to the reference {base}"
                + (
                    " (as chosen)"
                    if has_reference
                    else " (the best by IVCS; --reference names another)"
                )
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
    """Return the cells of two models in the scenarios and domains that both have."""
    by_model: dict[str, dict[tuple[str, str], Cell]] = {model: {}, base: {}}
    for cell in cells:
        if cell.model in by_model:
            by_model[cell.model][(cell.scenario, cell.domain)] = cell
    keys = sorted(by_model[model].keys() & by_model[base].keys())
    return [by_model[model][key] for key in keys], [by_model[base][key] for key in keys]


def _difference_panels(
    pairs: Mapping[str, tuple[list[Cell], list[Cell]]], names: dict[str, str]
) -> Sheet:
    value_pairs = {}
    for model, (own, others) in pairs.items():
        mine = next(iter(means(own, BY_MODEL).values()))
        theirs = next(iter(means(others, BY_MODEL).values()))
        value_pairs[model] = {key: (mine[key].value, theirs[key].value) for key in IVCS_LAST}
    apart = {
        model: {k: None if a is None or b is None else a - b for k, (a, b) in row.items()}
        for model, row in value_pairs.items()
    }
    most = max((abs(v) for row in apart.values() for v in row.values() if v is not None), default=0)
    limit = next(step for step in _LIMITS if most <= step + 1e-9)
    left_in, right_in, head_in = widest_in(names[m] for m in pairs) + 0.15, 0.55, 0.24
    room_in = PAGE_IN - left_in - right_in
    panel_in = (room_in - 0.14 * (len(IVCS_LAST) - 1)) / len(IVCS_LAST)
    height_in = ROW_IN * len(pairs)
    sheet = Sheet(PAGE_IN, head_in + height_in + 0.3)
    for column, key in enumerate(IVCS_LAST):
        axes = sheet.axes(left_in + column * (panel_in + 0.14), head_in, panel_in, height_in)
        axes.set_xlim(-limit, limit)
        name_rows(axes, [names[m] if column == 0 else "" for m in pairs])
        axes.set_title(METRIC_LABELS[key], pad=3, size=7.0)
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
                row,
                value,
                0.6,
                color=BLUE if gain else "white",
                edgecolor=BLUE if gain else RED,
                linewidth=0.6,
                hatch="" if gain else "//////",
                gid=f"bar-{model}-{key}",
            )
    page = sheet.page()
    page.text(PAGE_IN - 0.05, head_in - 0.07, "rel. IVCS", ha="right")
    for row, model in enumerate(pairs):
        share = relative_difference(*value_pairs[model]["ivcs"])
        text = "–" if share is None else f"{share:+z.0%}".replace("-", "−").replace("%", " %")
        page.text(
            PAGE_IN - 0.05, head_in + ROW_IN * (row + 0.5), text, ha="right", va="center_baseline"
        )
    return sheet


PROFILE = (*COMPONENTS, "act_acc_eff", "atc_eff")
MACRO_LOOK = Look(INK, "|", "")
CONSTANT_LOOK = Look(RED, "|", "")
_PANEL_COLUMNS, _MOST_PANEL_ROWS, _PANEL_IN = 4, 8, 1.2


def models(scores: Scores, reference: str | None) -> Iterator[Drawing | LeftOut]:
    """Yield the figures about models.

    Args:
        scores: of the rows.
        reference: the model that others are compared to; None: the best by IVCS.
    """
    yield from _range(scores)
    yield rank_slopes(scores, "model", "models_ranks")
    yield from _profiles(scores)
    yield from differences(scores, reference)


def scenario_looks(scenarios: Sequence[str]) -> dict[str, Look]:
    """Colour and shape of each scenario; with more than there are, they come round again."""
    return {scenario: LOOKS[k % len(LOOKS)] for k, scenario in enumerate(scenarios)}


def _range(scores: Scores) -> Iterator[Drawing | LeftOut]:
    name = "models_range"
    if not scores.by_model or "scenario" in scores.over:
        yield LeftOut(name, "the rows are means over scenarios" if scores.over else NO_MODEL)
        return
    width_in = row_width_in(scores.by_model)
    names = names_in(scores.by_model, NAMES_IN[width_in] - text_width_in(f" {MARK}"))
    looks = scenario_looks(scores.scenarios)
    legend = {words(name): look for name, look in looks.items()}
    legend["macro average"] = MACRO_LOOK
    constant, below = scores.constant("model"), scores.below("model")
    names = {m: f"{name} {MARK}" if (m,) in below else name for m, name in names.items()}
    if constant:
        legend[CONSTANT] = CONSTANT_LOOK
    for page, members in pages_of(name, list(scores.by_model)):
        sheet, axes, _ = named_rows(width_in, [names[m] for m in members], legend)
        for row, model in enumerate(members):
            ivcs_by_scenario = {
                scenario: group["ivcs"].value
                for scenario in scores.scenarios
                if (group := scores.by_scenario_model.get((scenario, model)))
            }
            ivcs_values = [value for value in ivcs_by_scenario.values() if value is not None]
            axes.plot(
                [min(ivcs_values), max(ivcs_values)],
                [row, row],
                color=GREY,
                linewidth=1.2,
                zorder=2,
            )
            for scenario, value in ivcs_by_scenario.items():
                if value is None:
                    continue
                mark(axes, (value, row), looks[scenario], f"scenario-{scenario}-{model}")
            draw_constant(axes, row, constant.get((model,)), model)
            axes.plot(
                [scores.by_model[model]["ivcs"].value or 0.0],
                [row],
                "|",
                color=INK,
                markersize=9,
                markeredgewidth=1.5,
                clip_on=False,
                zorder=4,
                gid=f"macro-{model}",
            )
        share_axis(axes, "IVCS")
        yield Drawing(
            page,
            sheet.figure,
            caption(
                "IVCS of each model: a mark per scenario, the line is their range, the "
                "upright stroke the macro average over all cells; the best by it comes first. "
                f"{scores.n_text()}.",
                scores.constant_text("The dashed red stroke"),
                scores.uneven("model"),
                scores.left_out,
                renamed({m: names[m].removesuffix(f" {MARK}") for m in members}),
            ),
        )


def draw_constant(axes: Axes, row: int, value: float | None, model: str) -> None:
    """Draw the best blind constant over the cells of a row's model, where it is known."""
    if value is not None:
        axes.plot(
            [value, value],
            [row - 0.5, row + 0.5],
            "--",
            color=RED,
            linewidth=0.9,
            zorder=3,
            gid=f"constant-{model}",
        )


def _profiles(scores: Scores) -> Iterator[Drawing | LeftOut]:
    name = "models_profiles"
    if not scores.by_model:
        yield LeftOut(name, NO_MODEL)
        return
    middle = [_median(group[key].value for group in scores.by_model.values()) for key in PROFILE]
    if len(scores.by_model) < 2:
        middle = []
    names = names_in(scores.by_model, _PANEL_IN + 0.12 - text_width_in(" 0.00"))
    for page, members in pages_of(name, list(scores.by_model), _PANEL_COLUMNS * _MOST_PANEL_ROWS):
        sheet = _panels(scores, {m: names[m] for m in members}, middle)
        yield Drawing(
            page,
            sheet.figure,
            caption(
                "Capability profiles: the mean of each component of IVCS (filled) and of the two "
                "diagnostic scores (hatched) over all cells of a model, the best by IVCS first, "
                "with its IVCS beside its name; the short line on a bar is the median over two or "
                "more models, – a score without "
                f"denominator in every cell. {scores.n_text()}.",
                scores.uneven("model"),
                scores.left_out,
                UNITS,
                renamed({m: names[m] for m in members}),
            ),
        )


def _median(values: Iterator[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return median(numbers) if numbers else None


def _panels(scores: Scores, members: Mapping[str, str], middle: Sequence[float | None]) -> Sheet:
    columns = min(_PANEL_COLUMNS, len(members))
    rows = -(-len(members) // columns)
    bar_in, head_in, gap_in, foot_in = 0.115, 0.19, 0.1, 0.34
    left_in, panel_in = 0.47, _PANEL_IN
    step_in = panel_in + (PAGE_IN - left_in - 0.1 - _PANEL_COLUMNS * panel_in) / (
        _PANEL_COLUMNS - 1
    )
    height_in = bar_in * len(PROFILE)
    width_in = left_in + step_in * (columns - 1) + panel_in + 0.15
    sheet = Sheet(width_in, rows * (head_in + height_in + gap_in) + foot_in)
    for index, (model, label) in enumerate(members.items()):
        row, column = divmod(index, columns)
        axes = sheet.axes(
            left_in + step_in * column,
            head_in + row * (head_in + height_in + gap_in),
            panel_in,
            height_in,
        )
        _profile(axes, model, scores.by_model[model], middle)
        first, last = column == 0, index + columns >= len(members)
        axes.set_yticks(
            range(len(PROFILE)), [METRIC_LABELS[k] for k in PROFILE] if first else [""] * 7
        )
        axes.tick_params(axis="y", length=0)
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"] if last else ["", "", ""])
        ivcs = format_mean(scores.by_model[model]["ivcs"].value)
        axes.set_title(f"{label} {ivcs}", loc="left", pad=3, size=7.0)
    page = sheet.page()
    page.text(
        (left_in + width_in - 0.15) / 2,
        sheet.height_in - 0.09,
        "mean score, from 0 to 1",
        ha="center",
        va="center_baseline",
    )
    return sheet


def _profile(axes: Axes, model: str, group: Group, middle: Sequence[float | None]) -> None:
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(len(PROFILE) - 0.5, -0.5)
    axes.grid(axis="x")
    for place, key in enumerate(PROFILE):
        value = group[key].value
        if value is None:
            axes.text(0.02, place, "–", va="center_baseline")
            continue
        diagnostic = key not in COMPONENTS
        axes.barh(
            place,
            value,
            0.66,
            color="white" if diagnostic else BLUE,
            edgecolor=BLUE,
            linewidth=0.5,
            hatch="////" if diagnostic else "",
            gid=f"bar-{model}-{key}",
        )
    for place, value in enumerate(middle):
        if value is not None:
            ends = [value, value], [place - 0.4, place + 0.4]
            axes.plot(*ends, color="white", linewidth=2.6, solid_capstyle="butt")
            axes.plot(*ends, color=INK, linewidth=1.2, solid_capstyle="butt")
