"""Slope plots: scenario – macro average – scenario, with changes of rank pointed out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from matplotlib.axes import Axes

from ssp_eval.figures.cloud import spread
from ssp_eval.figures.scores import Group, Scores, words
from ssp_eval.figures.style import (
    BLUE,
    COLUMN_IN,
    DOMAIN_LOOKS,
    GREY,
    INK,
    LINE_IN,
    PAGE_IN,
    RED,
    Drawing,
    LeftOut,
    Look,
    Sheet,
    caption,
    drawable,
    fitted,
    format_mean,
    names_in,
    renamed,
    text_width_in,
    widest_in,
)
from ssp_eval.score.aggregate import Ranking, mean, ranking
from ssp_eval.statistics.constants import CONSTANT, MARK

MACRO = "macro"
MOST = 60
# Scenarios of which a caption lists each rank, as the tables do.
_MOST_LISTED = 6
_UP, _DOWN, _OTHER, _SAME = ("-", BLUE), ("--", RED), ("-.", INK), (":", GREY)


def rank_slopes(scores: Scores, subject: str, name: str) -> Drawing | LeftOut:
    """Return IVCS of every model or domain per scenario, with the macro average in the middle."""
    standings = ranking(scores.cells, subject)
    groups = scores.by_domain if subject == "domain" else scores.by_model
    per_scenario = scores.by_scenario_domain if subject == "domain" else scores.by_scenario_model
    scenarios = sorted(standings.scenarios)
    if len(groups) < 2 or len(scenarios) < 2:
        return LeftOut(name, f"ranks change among two scenarios and two {subject}s at least")
    if len(groups) > MOST:
        return LeftOut(name, f"{len(groups)} lines can't be told apart; the limit is {MOST}")
    columns: list[str | None] = [*scenarios]
    columns.insert((len(scenarios) + 1) // 2, None)
    values = {
        one: [
            group["ivcs"].value
            if column is None
            else (cell["ivcs"].value if (cell := per_scenario.get((column, one))) else None)
            for column in columns
        ]
        for one, group in groups.items()
    }
    ranks = {
        one: [(standings.macro if c is None else standings.scenarios[c]).get(one) for c in columns]
        for one in groups
    }
    looks = DOMAIN_LOOKS if subject == "domain" else {}
    blind = _blind(scores, subject, columns)
    changed = {c.subject for c in standings.changes}
    below = scores.below("scenario", subject) | scores.below(subject)
    sheet, names = _draw(columns, values, ranks, changed, looks, blind, below)
    admission = "admitted cells" if subject == "domain" else "cells"
    counts = ", ".join(f"{one} {group['ivcs'].n}" for one, group in groups.items())
    return Drawing(
        name,
        sheet.figure,
        caption(
            f"IVCS by {subject} per scenario and over all of them (macro average), unweighted "
            f"means over {admission}; # stands before a rank, beside it the score. The large open "
            f"marks in the middle are the macro averages: {_macro(groups, standings)}.",
            f"Cells: {counts}.",
            "A solid line ends on a better rank than it began, a dashed one on a worse, a dash-dot "
            "one changes its rank in between only, a dotted one never.",
            _changes(standings, scenarios),
            scores.constant_text(
                "The faint dash-dot lines, one for each domain"
                if subject == "domain"
                else "The red dash-dot line"
            ),
            scores.unadmitted if subject == "domain" else "",
            scores.uneven(subject),
            scores.left_out,
            renamed(names),
        ),
    )


def _blind(
    scores: Scores, subject: str, columns: Sequence[str | None]
) -> dict[str, list[float | None]]:
    """Return the best blind constant's line by name: one for each domain, one for all models.

    Of models it is the mean over all their recordings, also where a model lacks some of them.
    """
    if not scores.constants:
        return {}
    if subject == "domain":
        over_all, of_one = scores.constant(subject), scores.constant("scenario", subject)
        return {
            name: [macro if c is None else of_one.get((c, name)) for c in columns]
            for (name,), macro in over_all.items()
        }
    cells = [cell for place, cell in scores.constants.items() if place in scores.places]
    return {
        CONSTANT: [
            mean(cell.score["ivcs"] for cell in cells if column in (None, cell.scenario)).value
            for column in columns
        ]
    }


def _macro(groups: Mapping[str, Group], standings: Ranking) -> str:
    return ", ".join(
        f"{one} {format_mean(group['ivcs'].value, 3)} (#{standings.macro[one]})"
        for one, group in groups.items()
    )


def _changes(standings: Ranking, scenarios: Sequence[str]) -> str:
    """Return a sentence that points out every line whose rank isn't the same in all scenarios."""
    changed = dict.fromkeys(change.subject for change in standings.changes)
    if not changed:
        return "No rank changes between scenarios."
    ranks = {one: [standings.scenarios[s].get(one) for s in scenarios] for one in changed}
    if len(scenarios) > _MOST_LISTED:
        scenario_ranks = {
            one: [rank for rank in line if rank is not None] for one, line in ranks.items()
        }
        listing = "; ".join(
            f"{one} {min(line)} to {max(line)}" for one, line in scenario_ranks.items()
        )
        return f"Ranks that change between scenarios, from the best to the worst: {listing}."
    listing = "; ".join(
        f"{one} {', '.join('–' if rank is None else str(rank) for rank in line)}"
        for one, line in ranks.items()
    )
    return f"Ranks that change between scenarios ({', '.join(map(words, scenarios))}): {listing}."


def _draw(
    columns: Sequence[str | None],
    values: Mapping[str, Sequence[float | None]],
    ranks: Mapping[str, Sequence[int | None]],
    changed: Collection[str],
    looks: Mapping[str, Look],
    blind: Mapping[str, Sequence[float | None]],
    below: Collection[tuple[str, ...]],
) -> tuple[Sheet, dict[str, str]]:
    plain_in, lead_in = text_width_in(f"0.88 #00{f' {MARK}' if below else ''}"), 0.24
    whole = len(columns) <= 3 and len(values) <= 12 and widest_in(map(drawable, values)) <= 1.0
    names = names_in(values, 1.0 if whole else 2.3)
    labels = {one: f"{name} {MARK}" if (one,) in below else name for one, name in names.items()}
    named_in = widest_in(labels.values()) + plain_in + text_width_in(" ") + lead_in
    starts = {one for one, line in values.items() if line[-1] is None}
    left_in = (named_in if starts else plain_in + lead_in) + 0.05
    wide = len(columns) > 3 or COLUMN_IN - left_in - named_in < 1.2
    width_in = PAGE_IN if wide else COLUMN_IN
    height_in, top_in = max(1.5, LINE_IN * len(values) + 0.2), 0.3
    named_below_in = 0.0 if looks or not blind else LINE_IN  # a line of its own hides no mark
    sheet = Sheet(width_in, top_in + height_in + 0.28 + named_below_in)
    page = sheet.page()
    span_in = width_in - left_in - named_in - 0.05
    step_in = span_in / (len(columns) - 1)
    xs = [left_in + step_in * k for k in range(len(columns))]
    present = [v for line in (*values.values(), *blind.values()) for v in line if v is not None]
    middle, half = (min(present) + max(present)) / 2, max(max(present) - min(present), 0.05) / 2

    def y_of(value: float) -> float:
        share = (value - middle) / (2 * half) + 0.5
        return top_in + 0.1 + (height_in - 0.2) * (1.0 - share)

    for column, x in zip(columns, xs, strict=True):
        page.plot([x, x], [top_in, top_in + height_in], color=GREY, linewidth=0.5)
        text = MACRO if column is None else words(column)
        for number, part in enumerate(_two_lines(text, step_in - 0.05)):
            page.text(
                x,
                top_in - 0.08 - LINE_IN * 0.85 * number,
                part,
                ha="center",
                style="italic" if column is None else "normal",
            )
    for one, line in blind.items():
        points = [(x, y_of(v)) for x, v in zip(xs, line, strict=True) if v is not None]
        page.plot(
            [x for x, _ in points],
            [y for _, y in points],
            linestyle=(0, (6, 1.5, 1, 1.5)),
            color=looks[one].colour if one in looks else RED,
            alpha=0.55,
            linewidth=0.8,
            zorder=1,
            gid=f"constant-{one}",
        )
    for one, line in values.items():
        style, colour = _style(ranks[one], columns, one in changed)
        colour, marker = (looks[one].colour, looks[one].marker) if one in looks else (colour, "o")
        line_points = [(x, y_of(v)) for x, v in zip(xs, line, strict=True) if v is not None]
        page.plot(
            [x for x, _ in line_points],
            [y for _, y in line_points],
            style,
            color=colour,
            marker=marker,
            markersize=4.0 if one in looks else 3.2,
            markerfacecolor="white" if colour == GREY else colour,
            markeredgewidth=0.7,
            linewidth=1.2 if one in changed else 0.9,
            gid=f"line-{one}",
        )
        macro = line[columns.index(None)]
        if macro is not None:
            page.plot(
                [xs[columns.index(None)]],
                [y_of(macro)],
                marker if one in looks else "D",
                color=colour,
                markersize=6.0 if len(values) <= 12 else 4.0,
                markerfacecolor="white",
                markeredgewidth=1.3,
                zorder=4,
                gid=f"macro-{one}",
            )
    bounds = (top_in + 0.05, top_in + height_in - 0.05)
    for index, side in ((0, -1), (len(columns) - 1, 1)):
        ends = {
            one: (
                y_of(value),
                _end_text(
                    side,
                    labels[one],
                    value,
                    ranks[one][index],
                    one in starts,
                    (columns[index] or "", one) in below,
                ),
            )
            for one, line in values.items()
            if (value := line[index]) is not None
        }
        _end_labels(page, xs[index], side, ends, bounds)
    scale = f"upwards: IVCS from {format_mean(middle - half)} to {format_mean(middle + half)}"
    page.text(left_in, sheet.height_in - 0.07 - named_below_in, scale, color=GREY)
    if named_below_in:
        mean = format_mean(blind[CONSTANT][columns.index(None)])
        note = f"dash-dotted: {CONSTANT}, {MACRO} {mean}"
        page.text(left_in, sheet.height_in - 0.07, note, color=RED)
    return sheet, names


def _two_lines(text: str, most_in: float) -> list[str]:
    """Return a heading from its lowest line up, broken at a space where it is too wide for one."""
    parts = text.split(" ")
    if text_width_in(drawable(text)) <= most_in or len(parts) == 1:
        return [fitted(text, most_in)]
    halves = [(" ".join(parts[:k]), " ".join(parts[k:])) for k in range(1, len(parts))]
    upper, lower = min(halves, key=lambda both: widest_in(map(drawable, both)))
    return [fitted(lower, most_in), fitted(upper, most_in)]


def _style(
    ranks: Sequence[int | None], columns: Sequence[str | None], changed: bool
) -> tuple[str, str]:
    if not changed:
        return _SAME
    scenario_ranks = [
        r for r, column in zip(ranks, columns, strict=True) if column and r is not None
    ]
    if scenario_ranks[-1] == scenario_ranks[0]:
        return _OTHER
    return _UP if scenario_ranks[-1] < scenario_ranks[0] else _DOWN


def _end_text(
    side: int, name: str, value: float, rank: int | None, starts: bool, is_below: bool
) -> str:
    """Rank and value next to a line's end, with its name at the right, where all lines go."""
    score = f"{format_mean(value)} {MARK}" if is_below else format_mean(value)
    if side > 0:
        return f"#{rank} {score} {name}"
    return f"{name} {score} #{rank}" if starts else f"{score} #{rank}"


def _end_labels(
    page: Axes,
    x: float,
    side: int,
    ends: Mapping[str, tuple[float, str]],
    bounds: tuple[float, float],
) -> None:
    """Draw the texts at one end, moved apart and led to their points."""
    point_ys = [y for y, _ in ends.values()]
    places = spread(point_ys, LINE_IN - 0.02, *bounds)
    for (one, (y, text)), at in zip(ends.items(), places, strict=True):
        page.plot([x + side * 0.05, x + side * 0.16], [y, at], color=GREY, linewidth=0.4)
        page.text(
            x + side * 0.19,
            at,
            text,
            ha="left" if side > 0 else "right",
            va="center",
            gid=f"label-{'right' if side > 0 else 'left'}-{one}",
        )
