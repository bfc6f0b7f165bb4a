"""Domains (METHOD 7.2): components, ranks from scenario to scenario, contributions to IVCS."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_eval.figures.ranks import rank_slopes
from ssp_eval.figures.scores import Scores, words
from ssp_eval.figures.style import (
    COLUMN_IN,
    COMPONENT_LOOKS,
    DOMAIN_LOOKS,
    FAINT,
    INK,
    UNITS,
    Drawing,
    LeftOut,
    Sheet,
    caption,
    fitted,
    format_mean,
    legend_height_in,
    mark,
    mark_legend,
    share_axis,
)
from ssp_eval.score.aggregate import Cell, mean
from ssp_eval.score.metrics import COMPONENTS, METRIC_LABELS, ivcs_terms, ivcs_weights

NONE_ADMITTED = "no cell is admitted to domain means"


def domains(scores: Scores) -> Iterator[Drawing | LeftOut]:
    """Yield the three figures about domains."""
    if "domain" in scores.over:
        yield LeftOut("domains", "the rows are means over domains")
        return
    yield _components(scores)
    yield rank_slopes(scores, "domain", "domains_ranks")
    yield _contributions(scores)


def _admitted(scores: Scores) -> list[Cell]:
    return [cell for cell in scores.cells if cell.admitted]


def _components(scores: Scores) -> Drawing | LeftOut:
    name = "domains_components"
    groups = scores.by_domain
    if not groups:
        return LeftOut(name, NONE_ADMITTED)
    lane_in, left_in = 0.13, 0.52
    legend = {f"{d} (n = {group['ivcs'].n})": DOMAIN_LOOKS[d] for d, group in groups.items()}
    head_in = 0.06 + legend_height_in(list(legend), COLUMN_IN)
    row_in = lane_in * len(groups) + 0.1
    height_in = row_in * len(COMPONENTS)
    sheet = Sheet(COLUMN_IN, head_in + height_in + 0.42)
    axes = sheet.axes(left_in, head_in, COLUMN_IN - left_in - 0.1, height_in)
    axes.set_ylim(height_in, 0.0)
    admitted = _admitted(scores)
    for row, key in enumerate(COMPONENTS):
        if row:
            axes.axhline(row * row_in, color=FAINT, linewidth=0.5)
        for lane, (domain, group) in enumerate(groups.items()):
            look = DOMAIN_LOOKS[domain]
            y = row * row_in + 0.05 + lane_in * (lane + 0.5)
            values = [cell.score[key] for cell in admitted if cell.domain == domain]
            cell_scores = [value for value in values if value is not None]
            if cell_scores:
                axes.plot(
                    [min(cell_scores), max(cell_scores)], [y, y], color=look.colour, linewidth=0.7
                )
            axes.plot(
                cell_scores,
                [y] * len(cell_scores),
                "|",
                color=look.colour,
                markersize=4,
                markeredgewidth=0.6,
                clip_on=False,
                gid=f"cells-{key}-{domain}",
            )
            value = group[key].value
            if value is not None:
                mark(axes, (value, y), look, f"mean-{key}-{domain}", zorder=4)
    axes.set_yticks(
        [(row + 0.5) * row_in for row in range(len(COMPONENTS))],
        [METRIC_LABELS[key] for key in COMPONENTS],
    )
    axes.tick_params(axis="y", length=0)
    share_axis(axes, "score, mean over cells (ticks: single cells)")
    mark_legend(sheet, legend, 0.11)
    cells = ", ".join(f"{domain} {group['ivcs'].n}" for domain, group in groups.items())
    fewer = [
        f"{METRIC_LABELS[key]} in {domain}: {group[key].n}"
        for domain, group in groups.items()
        for key in COMPONENTS
        if group[key].n != group["ivcs"].n
    ]
    return Drawing(
        name,
        sheet.figure,
        caption(
            "The five components of IVCS by domain: the large mark is the unweighted mean over "
            "admitted cells, a tick is one cell, the line spans them. "
            f"Cells: {cells}.",
            f"With fewer values, since others have no denominator: {'; '.join(fewer)}."
            if fewer
            else "",
            scores.unadmitted,
            scores.left_out,
            UNITS,
        ),
    )


def _contributions(scores: Scores) -> Drawing | LeftOut:
    name = "domains_contributions"
    admitted = _admitted(scores)
    if not admitted:
        return LeftOut(name, NONE_ADMITTED)
    groups: list[tuple[str, str, list[Cell]]] = []
    for scenario in scores.scenarios:
        for domain in scores.by_domain:
            cells = [c for c in admitted if (c.scenario, c.domain) == (scenario, domain)]
            if cells:
                groups.append((words(scenario), domain, cells))
    if len({scenario for scenario, _, _ in groups}) > 1:
        groups += [
            ("all scenarios", domain, [c for c in admitted if c.domain == domain])
            for domain in scores.by_domain
        ]
    return _stacks(name, groups, scores)


def _stacks(
    name: str, groups: list[tuple[str, str, list[Cell]]], scores: Scores
) -> Drawing | LeftOut:
    bar_in, band_in, left_in = 0.17, 0.19, 0.8
    looks = {METRIC_LABELS[key]: COMPONENT_LOOKS[key] for key in COMPONENTS}
    head_in = 0.06 + legend_height_in(list(looks), COLUMN_IN)
    bands = len({scenario for scenario, _, _ in groups})
    height_in = bar_in * len(groups) + band_in * bands + 0.05
    sheet = Sheet(COLUMN_IN, head_in + height_in + 0.42)
    axes = sheet.axes(left_in, head_in, COLUMN_IN - left_in - 0.36, height_in)
    axes.set_ylim(height_in, 0.0)
    page = sheet.page()
    y, before = 0.0, ""
    ticks, labels = [], []
    for scenario, domain, cells in groups:
        if scenario != before:
            page.text(
                0.05,
                head_in + y + band_in - 0.05,
                fitted(scenario, COLUMN_IN - 0.2),
                weight="bold",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
            )
            y, before = y + band_in, scenario
        terms = [ivcs_terms(cell.score) for cell in cells]
        left = 0.0
        for key in COMPONENTS:
            width = mean(term[key] for term in terms).value or 0.0
            look = COMPONENT_LOOKS[key]
            axes.barh(
                y + bar_in / 2,
                width,
                bar_in * 0.78,
                left,
                color=look.colour,
                edgecolor=INK,
                linewidth=0.4,
                hatch=look.hatch,
                gid=f"part-{scenario}-{domain}-{key}",
            )
            left += width
        axes.text(left + 0.015, y + bar_in / 2, format_mean(left), va="center_baseline")
        ticks.append(y + bar_in / 2)
        labels.append(domain)
        y += bar_in
    axes.set_yticks(ticks, labels)
    axes.tick_params(axis="y", length=0)
    share_axis(axes, "IVCS, mean over cells")
    axes.set_xlim(0.0, 1.0)
    mark_legend(sheet, looks, 0.11)
    counts = "; ".join(f"{scenario} {domain} {len(cells)}" for scenario, domain, cells in groups)
    weights = ", ".join(f"{w:.2f} {METRIC_LABELS[key]}" for key, w in ivcs_weights().items())
    nulls = [row for row in scores.entering if row.admitted and row.ivcs_nulls]
    return Drawing(
        name,
        sheet.figure,
        caption(
            f"What the components add to IVCS ({weights}), by scenario and domain, as unweighted "
            f"means over admitted cells; the number is their sum. Cells: {counts}.",
            f"A component without denominator adds 0, in {len(nulls)} cells." if nulls else "",
            scores.unadmitted,
            scores.left_out,
            UNITS,
        ),
    )
