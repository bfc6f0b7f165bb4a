"""Models (METHOD 7.3): range over scenarios, ranks, profiles, differences to a reference."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from matplotlib.axes import Axes

from ssp_eval.figures.differences import differences
from ssp_eval.figures.drawing import (
    UNITS,
    Drawing,
    LeftOut,
    caption,
    page_name,
    pages_of,
    renamed,
    shown_mean,
)
from ssp_eval.figures.named_rows import COMPONENTS, NO_MODEL, named_rows, row_pages
from ssp_eval.figures.ranks import rank_slopes
from ssp_eval.figures.scores import Group, Scores, words
from ssp_eval.figures.style import (
    BLUE,
    COMPONENT_NAMES,
    GREY,
    INK,
    LOOKS,
    NAMES_IN,
    PAGE_IN,
    Look,
    Sheet,
    names_in,
    row_width_in,
    share_axis,
    text_width_in,
)

PROFILE = (*COMPONENTS, "act_acc_eff", "atc_eff")
MACRO_LOOK = Look(INK, "|", "")
_PANEL_COLUMNS, _MOST_PANEL_ROWS, _PANEL_IN = 4, 8, 1.2


def models(scores: Scores, reference: str | None) -> Iterator[Drawing | LeftOut]:
    """The figures about models.

    Args:
        scores: what is shown.
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
    names = names_in(scores.by_model, NAMES_IN[width_in])
    looks = scenario_looks(scores.scenarios)
    legend = {words(name): look for name, look in looks.items()}
    legend["macro average"] = MACRO_LOOK
    pages = row_pages(list(scores.by_model))
    for number, members in enumerate(pages, start=1):
        sheet, axes, _ = named_rows(width_in, [names[m] for m in members], legend)
        for row, model in enumerate(members):
            found = {
                scenario: group["ivcs"].value
                for scenario in scores.scenarios
                if (group := scores.by_scenario_model.get((scenario, model)))
            }
            known = [value for value in found.values() if value is not None]
            axes.plot([min(known), max(known)], [row, row], color=GREY, linewidth=1.2, zorder=2)
            for scenario, value in found.items():
                if value is None:
                    continue
                look = looks[scenario]
                axes.plot(
                    [value], [row], look.marker, color=look.colour, markeredgecolor=INK,
                    markeredgewidth=0.4, clip_on=False, zorder=3,
                    gid=f"scenario-{scenario}-{model}",
                )  # fmt: skip
            axes.plot(
                [scores.by_model[model]["ivcs"].value or 0.0], [row], "|", color=INK, markersize=9,
                markeredgewidth=1.5, clip_on=False, zorder=4,
                gid=f"macro-{model}",
            )  # fmt: skip
        share_axis(axes, "IVCS")
        yield Drawing(
            page_name(name, number, len(pages)),
            sheet.figure,
            caption(
                "IVCS of each model: a mark per scenario, the line is their range, the "
                "upright stroke the macro average over all cells; the best by it comes first. "
                f"{scores.n_text()}.",
                scores.uneven("model"),
                scores.left_out,
                renamed({m: names[m] for m in members}),
            ),
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
    pages = pages_of(list(scores.by_model), _PANEL_COLUMNS * _MOST_PANEL_ROWS)
    for number, members in enumerate(pages, start=1):
        sheet = _panels(scores, {m: names[m] for m in members}, middle)
        yield Drawing(
            page_name(name, number, len(pages)),
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
    known = sorted(value for value in values if value is not None)
    if not known:
        return None
    half = len(known) // 2
    return known[half] if len(known) % 2 else (known[half - 1] + known[half]) / 2


def _panels(scores: Scores, members: Mapping[str, str], middle: Sequence[float | None]) -> Sheet:
    columns = min(_PANEL_COLUMNS, len(members))
    rows = -(-len(members) // columns)
    bar_in, head_in, gap_in, foot_in = 0.115, 0.19, 0.1, 0.3
    left_in, panel_in = 0.47, _PANEL_IN
    step_in = panel_in + (PAGE_IN - left_in - 0.1 - _PANEL_COLUMNS * panel_in) / (
        _PANEL_COLUMNS - 1
    )
    height_in = bar_in * len(PROFILE)
    width_in = left_in + step_in * (columns - 1) + panel_in + 0.15
    sheet = Sheet(width_in, rows * (head_in + height_in + gap_in) + foot_in)
    for index, (model, shown) in enumerate(members.items()):
        row, column = divmod(index, columns)
        axes = sheet.axes(
            left_in + step_in * column, head_in + row * (head_in + height_in + gap_in), panel_in,
            height_in,
        )  # fmt: skip
        _profile(axes, model, scores.by_model[model], middle)
        first, last = column == 0, index + columns >= len(members)
        axes.set_yticks(
            range(len(PROFILE)), [COMPONENT_NAMES[k] for k in PROFILE] if first else [""] * 7
        )
        axes.tick_params(axis="y", length=0)
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"] if last else ["", "", ""])
        ivcs = shown_mean(scores.by_model[model]["ivcs"].value)
        axes.set_title(f"{shown} {ivcs}", loc="left", pad=3, size=7.0)
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
            place, value, 0.66, color="white" if diagnostic else BLUE, edgecolor=BLUE,
            linewidth=0.5, hatch="////" if diagnostic else "", gid=f"bar-{model}-{key}",
        )  # fmt: skip
    for place, value in enumerate(middle):
        if value is not None:
            ends = [value, value], [place - 0.4, place + 0.4]
            axes.plot(*ends, color="white", linewidth=2.6, solid_capstyle="butt")
            axes.plot(*ends, color=INK, linewidth=1.2, solid_capstyle="butt")
