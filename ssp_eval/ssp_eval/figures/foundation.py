"""Foundation models and architectures (METHOD 7.4): what scores cost in parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from ssp_eval.figures.cloud import (
    MOST_POINTS,
    Point,
    cloud,
    numbers_used,
    share_axis_near,
    steps_of,
)
from ssp_eval.figures.models import draw_constant
from ssp_eval.figures.scores import Scores, listed, pareto_front
from ssp_eval.figures.style import (
    BLUE,
    COLUMN_IN,
    FAINT,
    GREY,
    INK,
    LOOKS,
    NAMES_IN,
    NO_MODEL,
    ORANGE,
    ROW_IN,
    SQUARE,
    UNITS,
    Drawing,
    LeftOut,
    Look,
    caption,
    format_mean,
    mark,
    named_rows,
    names_in,
    pages_of,
    renamed,
    row_width_in,
    share_axis,
    widest_in,
)
from ssp_eval.score.aggregate import Mean, mean, ranks
from ssp_eval.score.metrics import IVCS_LAST, METRIC_LABELS
from ssp_eval.statistics.constants import MARK
from ssp_eval.statistics.table import counted


def architectures(scores: Scores) -> Drawing | LeftOut:
    """Return a dumbbell per score of the two architectures that most models have."""
    name = "foundation_architectures"
    members: dict[str, list[str]] = {}
    for model in scores.by_model:
        if scores.facts[model].architecture:
            members.setdefault(scores.facts[model].architecture, []).append(model)
    order = sorted(members, key=lambda a: (-len(members[a]), a))
    if len(order) < 2:
        return LeftOut(name, "fewer than two architectures are known")
    first, second = sorted(order[:2])
    means: dict[str, dict[str, Mean]] = {
        one: {
            key: mean(c.score[key] for c in scores.cells if c.model in members[one])
            for key in IVCS_LAST
        }
        for one in (first, second)
    }
    looks = {first: Look(BLUE, "o", ""), second: Look(ORANGE, "s", "")}
    titles = names_in(looks, 1.9)
    legend = {f"{titles[one]} (models: {len(members[one])})": look for one, look in looks.items()}
    titled = [METRIC_LABELS[key] for key in IVCS_LAST]
    sheet, axes, _ = named_rows(COLUMN_IN, titled, legend, right_in=0.4, row_in=0.22)
    axes.axhline(len(IVCS_LAST) - 1.5, color=FAINT, linewidth=0.6)
    for row, key in enumerate(IVCS_LAST):
        ends = {one: means[one][key].value for one in looks}
        end_values = [value for value in ends.values() if value is not None]
        if len(end_values) == 2:
            axes.plot(end_values, [row, row], color=GREY, linewidth=1.4, zorder=2, gid=f"bar-{key}")
            text = f"{end_values[1] - end_values[0]:+z.2f}".replace("-", "−")
            axes.text(1.05, row, text, va="center_baseline", clip_on=False)
        for one, value in ends.items():
            if value is not None:
                mark(axes, (value, row), looks[one], f"end-{key}-{one}")
    share_axis(axes, "score, mean over cells")
    counts = "; ".join(
        f"{one}: {counted(means[one]['ivcs'].n, 'cell')} of {listed(members[one])}" for one in looks
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


UNKNOWN = "architecture not given"
_NUMBERS = "Numbers stand for the models in the list, which is in the order of IVCS."


def foundation(scores: Scores) -> Iterator[Drawing | LeftOut]:
    """Yield the four figures about foundation models."""
    yield _semantics_trajectory(scores)
    yield _parameters(scores)
    yield architectures(scores)
    yield from _ranking(scores)


def _architecture(scores: Scores, model: str) -> str:
    return scores.facts[model].architecture or UNKNOWN


def _kinds(scores: Scores, models: Sequence[str]) -> tuple[dict[str, Look], dict[str, str]]:
    """Return the look by architecture, none and grey last, and the kind of each model."""
    kinds = {model: _architecture(scores, model) for model in models}
    names = sorted({row.architecture for row in scores.facts.values() if row.architecture})
    looks = {name: LOOKS[k % len(LOOKS)] for k, name in enumerate(names)}
    looks[UNKNOWN] = Look("#bdbdbd", "o", "")
    return {name: look for name, look in looks.items() if name in set(kinds.values())}, kinds


def _points(name: str, points: Mapping[str, Point]) -> LeftOut | None:
    if not points:
        return LeftOut(name, NO_MODEL)
    if len(points) > MOST_POINTS:
        return LeftOut(name, f"{len(points)} points can't be told apart; at most {MOST_POINTS}")
    return None


def _semantics_trajectory(scores: Scores) -> Drawing | LeftOut:
    name = "foundation_semantics_trajectory"
    points: dict[str, Point] = {
        model: (x, y)
        for model, group in scores.by_model.items()
        if (x := group["sem_acc_eff"].value) is not None and (y := group["tqsr"].value) is not None
    }
    if refusal := _points(name, points):
        return refusal
    front = pareto_front(points)

    def set_up(axes: Axes) -> Sequence[Point]:
        share_axis_near(axes, "x", "SemAcc, mean over cells", [x for x, _ in points.values()])
        share_axis_near(axes, "y", "TQSR, mean over cells", [y for _, y in points.values()])
        low = (axes.get_xlim()[0], axes.get_ylim()[0])
        border = steps_of([points[model] for model in front], low)
        axes.plot(*zip(*border, strict=True), "--", color=INK, linewidth=0.8, zorder=1, gid="front")
        return border

    plot = cloud(points, *_kinds(scores, list(points)), set_up, set(front))
    if plot is None:
        return LeftOut(name, "the points lie too close for labels")
    sheet, names = plot
    missing = [model for model in scores.by_model if model not in points]
    return Drawing(
        name,
        sheet.figure,
        caption(
            "Semantics (SemAcc) against trajectory quality (TQSR), unweighted means over all cells "
            f"of a model; {scores.n_text()}. Right of and above the dashed line, the Pareto front, "
            f"is no model; on it, with a thick border, {_are(front)}.",
            _NUMBERS if numbers_used(sheet) else "",
            f"Without a value, and not shown: {listed(missing)}." if missing else "",
            scores.uneven("model"),
            scores.left_out,
            UNITS,
            renamed(names),
        ),
    )


def _are(names: Sequence[str]) -> str:
    return f"{'is' if len(names) == 1 else 'are'} {listed(names)}"


def _parameters(scores: Scores) -> Drawing | LeftOut:
    name = "foundation_parameters"
    points: dict[str, Point] = {
        model: (active, y)
        for model, group in scores.by_model.items()
        if (active := scores.facts[model].active_b) is not None
        and (y := group["tqsr"].value) is not None
    }
    others = [model for model in scores.by_model if model not in points]
    if not points and others:
        return LeftOut(name, "no model's number of active parameters is known")
    if refusal := _points(name, points):
        return refusal
    low = min(x for x, _ in points.values())
    high = max(x for x, _ in points.values())

    def set_up(axes: Axes) -> Sequence[Point]:
        axes.set_xscale("log")
        axes.set_xlim(low / 1.6, high * 1.6)
        ticks = _log_ticks(low / 1.6, high * 1.6)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlabel("active parameters (billions, log scale)", labelpad=2)
        axes.grid(axis="x")
        share_axis_near(axes, "y", "TQSR, mean over cells", [y for _, y in points.values()])
        return ()

    text = f"not shown, since unknown: {listed(others)}" if others else ""
    plot = cloud(points, *_kinds(scores, list(points)), set_up, note=text)
    if plot is None:
        return LeftOut(name, "the points lie too close for labels")
    sheet, names = plot
    return Drawing(
        name,
        sheet.figure,
        caption(
            "Trajectory quality (TQSR, unweighted mean over all cells of a model) against the "
            f"number of active parameters, for the {len(points)} of {len(scores.by_model)} models "
            f"where it is known and so comparable; {scores.n_text()}.",
            f"Not known, and not shown: {listed(others)}." if others else "",
            scores.uneven("model"),
            _NUMBERS if numbers_used(sheet) else "",
            scores.left_out,
            renamed(names),
        ),
    )


def _log_ticks(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 of each decade between the limits; only 1 where these are too many."""
    decades = [10.0**k for k in range(-6, 9)]
    ticks = [m * d for d in decades for m in (1, 2, 5) if low <= m * d <= high]
    return ticks if len(ticks) <= 8 else [tick for tick in decades if low <= tick <= high]


def _ranking(scores: Scores) -> Iterator[Drawing | LeftOut]:
    name = "foundation_ranking"
    if not scores.by_model:
        yield LeftOut(name, NO_MODEL)
        return
    places = ranks({model: group["ivcs"].value for model, group in scores.by_model.items()})
    looks, kinds = _kinds(scores, list(scores.by_model))
    counts = Counter(kinds.values())
    width_in = row_width_in(scores.by_model)
    names = names_in(scores.by_model, NAMES_IN[width_in])
    constant, below = scores.constant("model"), scores.below("model")
    labels = {
        model: f"{places[model]}  {names[model]}{f' {MARK}' if (model,) in below else ''}"
        for model in scores.by_model
    }
    size = {model: _size(scores, model) for model in scores.by_model}
    right_in = max(0.12, widest_in(size.values()) + 0.15)
    legend = (
        {a: Look(k.colour, SQUARE, k.hatch) for a, k in looks.items()} if len(looks) > 1 else {}
    )
    for page, members in pages_of(name, list(scores.by_model)):
        sheet, axes, head_in = named_rows(width_in, [labels[m] for m in members], legend, right_in)
        for row, model in enumerate(members):
            value, look = scores.by_model[model]["ivcs"].value or 0.0, looks[kinds[model]]
            axes.barh(
                row,
                value,
                0.68,
                color=look.colour,
                edgecolor=INK,
                linewidth=0.4,
                hatch=look.hatch,
                gid=f"bar-{model}",
            )
            draw_constant(axes, row, constant.get((model,)), model)
            axes.text(value + 0.02, row, format_mean(value), va="center_baseline")
            sheet.figure.text(
                1.0 - 0.05 / width_in,
                1.0 - (head_in + ROW_IN * (row + 0.5)) / sheet.height_in,
                size[model],
                va="center_baseline",
                ha="right",
                color=GREY,
            )
        share_axis(axes, "IVCS, mean over cells")
        axes.set_xlim(0.0, 1.02)
        has_sizes = any(size.values())
        yield Drawing(
            page,
            sheet.figure,
            caption(
                "Models by IVCS, the unweighted mean over all their cells, with their rank; equal "
                f"ones share a rank. {scores.n_text()}.",
                "At the right total / active parameters in billions, ? where not known."
                if has_sizes
                else "",
                f"Architectures: {', '.join(f'{a} {n}' for a, n in sorted(counts.items()))}.",
                "Ranks per scenario are in models_ranks.",
                scores.constant_text("The dashed red line"),
                scores.uneven("model"),
                scores.left_out,
                renamed({m: names[m] for m in members}),
            ),
        )


def _size(scores: Scores, model: str) -> str:
    row = scores.facts[model]
    if row.total_b is None and row.active_b is None:
        return ""
    total, active = (
        "?" if value is None else f"{value:.3g}" for value in (row.total_b, row.active_b)
    )
    return f"{total} / {active}"
