"""The tables of a campaign of driven runs, in the form that every table has."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from statistics import median

from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop.comparisons import LEAST_EVENTS, Pair, over_events, pairs_of
from ssp_eval.closed_loop.folder import LoopCampaign, Run
from ssp_eval.score.cli import NULL
from ssp_eval.statistics.table import Column, Table, Value
from ssp_scenario_manager.closed_loop.outcomes.outcome import OUTCOMES
from ssp_scenario_manager.closed_loop.outcomes.rates import CRITICAL, Rates, RunRow

_SEVERITY = (
    ("v_i_mps", "v_i, m/s"),
    ("severity", "severity"),
    ("ttc_s", "TTC, s"),
    ("distance_m", "distance, m"),
    ("pet_s", "PET, s"),
    ("needed_mps2", "needed, m/s²"),
    ("jerk_mps3", "jerk, m/s³"),
    ("replan_m", "re-plan, m"),
)

# METHOD 8.8 wants means of these; a single TTC or deceleration would carry that of the others.
_MEANS = ("v_i_mps", "severity")


def with_ends(value: float | None, low: float | None, high: float | None) -> str:
    """Return a share with its interval, as a cell."""
    if value is None:
        return NULL
    return f"{value:.2f}" + ("" if low is None else f" [{low:.2f}, {high:.2f}]")


def headline_table(campaign: LoopCampaign, event: str, drivers: Sequence[str]) -> Table:
    """Return the headlines of one event: drivers over latencies."""
    by_place = {(one.driver, one.latency): one for one in campaign.rates if one.event == event}
    latencies = sorted({latency for _, latency in by_place})
    columns = [Column("driver", "driver", "text"), Column("rank", "", "text")]
    columns += [Column(f"l_{k}", value.words, "text") for k, value in enumerate(latencies)]
    rows = []
    for driver in drivers:
        cells: list[Value] = []
        for latency in latencies:
            one = by_place.get((driver, latency))
            cells.append(NULL if one is None else with_ends(one.headline, one.low, one.high))
        marked = "privileged" if campaign.card(driver)["privileged"] else ""
        rows.append((driver, marked, *cells))
    return Table(f"headline_{event}", event, tuple(columns), tuple(rows))


def outcome_table(rates: Iterable[Rates], event: str, drivers: Sequence[str]) -> Table:
    """Return how many runs of one event have which outcome; those that none has are left out."""
    own = [one for one in rates if one.event == event and one.driver in drivers]
    there = [k for k in range(len(OUTCOMES)) if any(one.outcomes[k] for one in own)]
    columns = (
        *(Column("driver", "driver", "text"), Column("latency", "L, s", "number")),
        *(Column("planned", "runs", "count"), Column("worst", "worst case", "decimal")),
        *(Column(OUTCOMES[k], OUTCOMES[k].replace("_", " "), "count") for k in there),
        *(Column("needless", "needless", "count"), Column("starved", "starved", "count")),
        *(Column("within_sd", "sd within", "decimal"), Column("between_sd", "between", "decimal")),
    )
    rows = tuple(
        (
            *(one.driver, one.latency.cell_text, one.planned, one.worst),
            *(one.outcomes[k] for k in there),
            *(one.needless, one.starved, one.within_sd, one.between_sd),
        )
        for one in own
    )
    return Table(f"outcomes_{event}", event, columns, rows)


def other_starts_table(campaign: LoopCampaign, drivers: Sequence[str]) -> Table:
    """Return how many runs on starts that aren't critical have which outcome (METHOD 8.1)."""
    cells: dict[tuple[str, str, str, Latency], list[RunRow]] = {}
    for row in (run.row for run in campaign.runs):
        if row.kind != CRITICAL and row.driver in drivers:
            cells.setdefault((row.event, row.kind, row.driver, row.latency), []).append(row)
    counts = {cell: Counter(row.outcome for row in rows) for cell, rows in cells.items()}
    there = [kind for kind in OUTCOMES if any(count[kind] for count in counts.values())]
    return Table(
        "other_starts",
        "On harmless and unavoidable starts",
        (
            *(Column("event", "event", "text"), Column("kind", "start", "text")),
            *(Column("driver", "driver", "text"), Column("latency", "L, s", "number")),
            Column("planned", "runs", "count"),
            *(Column(kind, kind.replace("_", " "), "count") for kind in there),
            Column("needless", "needless", "count"),
        ),
        tuple(
            (
                *(event, kind, driver, latency.cell_text, len(rows)),
                *(counts[event, kind, driver, latency][one] for one in there),
                sum(bool(row.needless) for row in rows),
            )
            for (event, kind, driver, latency), rows in cells.items()
        ),
        notes=(
            "They enter no headline. On a harmless start a VUT that doesn't respond has no "
            "contact, and avoiding it is no response; on an unavoidable one the oracle has one.",
        ),
    )


def severity_table(campaign: LoopCampaign, event: str, drivers: Sequence[str]) -> Table:
    """Return the means of the measures of harm, each with the number of runs that have it."""
    columns = [Column("driver", "driver", "text"), Column("latency", "L, s", "number")]
    columns += [Column(name, title, "text") for name, title in _SEVERITY]
    rows: list[tuple[Value, ...]] = []
    cells: dict[tuple[str, Latency], list[Run]] = {}
    for run in campaign.critical:
        if run.row.event == event and run.row.driver in drivers:
            cells.setdefault((run.row.driver, run.row.latency), []).append(run)
    for (driver, latency), runs in cells.items():
        rows.append((driver, latency.cell_text, *(_middle(runs, name) for name, _ in _SEVERITY)))
    return Table(
        f"severity_{event}",
        event,
        tuple(columns),
        tuple(rows),
        notes=(
            "Means of v_i and severity, medians of the others, over the runs that have a value; "
            "their number follows it. The smallest TTC and distance, the largest needed "
            "deceleration and jerk of each run lie between the hand-over and its deciding fact.",
        ),
    )


def _middle(runs: Sequence[Run], name: str) -> str:
    """Return the mean or, of what has no bound, the median of a column, as a cell."""
    values = [value for run in runs if (value := run.value(name)) is not None]
    if not values:
        return NULL
    middle = math.fsum(values) / len(values) if name in _MEANS else median(values)
    return f"{middle:.2f} ({len(values)})"


def over_events_table(campaign: LoopCampaign, drivers: Sequence[str]) -> Table:
    """Return the headlines over events, with an interval from eight events on."""
    headlines = {
        (one.event, one.driver, one.latency): one.headline
        for one in campaign.rates
        if one.driver in drivers
    }
    summaries = over_events(campaign.runs, headlines)
    latencies = sorted({one.latency for one in summaries})
    cells = {
        (one.driver, one.latency): with_ends(one.headline, one.interval.low, one.interval.high)
        + (f" ({one.events})" if one.events < len(campaign.plan.events) else "")
        for one in summaries
    }
    events = len(campaign.plan.events)
    note = (
        "The interval is a bootstrap over events, then starts (expanded percentile, 95 %)."
        if events >= LEAST_EVENTS
        else f"There is an interval from {LEAST_EVENTS} events on."
    )
    return Table(
        "over_events",
        "Headline over events",
        (
            Column("driver", "driver", "text"),
            *(Column(f"l_{k}", s.words, "text") for k, s in enumerate(latencies)),
        ),
        tuple(
            (driver, *(cells.get((driver, latency), NULL) for latency in latencies))
            for driver in drivers
            if any((driver, latency) in cells for latency in latencies)
        ),
        notes=(
            "Each event counts once; in brackets how many, where a driver isn't defined for all. "
            + note,
        ),
    )


def unlike_pair_table(
    campaign: LoopCampaign, drivers: Sequence[str], others: Sequence[str]
) -> Table:
    """Return McNemar's exact test of drivers against others that drove under other conditions.

    Args:
        campaign: whose critical starts they drove.
        drivers: of one group.
        others: of other groups.
    """
    pairs = pairs_of(campaign.runs, drivers, others)
    table = _pairs("pairs_unlike", "under unlike conditions", campaign, pairs)
    note = (
        "The cards of the two differ: a difference may come from their inputs, not their behaviour."
    )
    return replace(table, notes=(note, *table.notes))


def pair_table(
    campaign: LoopCampaign, drivers: Sequence[str], beside: Sequence[str] | None = None
) -> Table:
    """Return McNemar's exact test of each two drivers of a group.

    Args:
        campaign: whose critical starts they drove.
        drivers: of the group.
        beside: pairs without one of these are left out; None: none is.
    """
    subjects = drivers if beside is None else beside
    pairs = [
        one
        for one in pairs_of(campaign.runs, drivers)
        if one.first in subjects or one.second in subjects
    ]
    return _pairs("pairs", "of drivers", campaign, pairs)


def _pairs(name: str, what: str, campaign: LoopCampaign, pairs: Sequence[Pair]) -> Table:
    events = ", ".join(campaign.plan.events)
    return Table(
        name,
        f"Pairs {what}, for these events: {events}",
        (
            Column("first", "driver", "text"),
            Column("second", "against", "text"),
            Column("latency", "L, s", "number"),
            Column("starts", "starts", "count"),
            Column("more", "first alone", "count"),
            Column("fewer", "second alone", "count"),
            Column("p", "p", "p"),
            Column("p_least", "least p", "p"),
        ),
        tuple(
            (
                *(o.first, o.second, o.latency.cell_text, o.starts),
                *(o.test.more, o.test.fewer, o.test.p, o.test.p_least),
            )
            for o in pairs
        ),
        notes=(
            "McNemar's exact test on the same (event, start, L), for these events: it says nothing "
            "about others. First alone: starts on which the first driver succeeds and the second "
            "doesn't. Least p: the smallest p that as many differing starts can give. "
            "Of many pairs some are below 0.05 by chance.",
        ),
    )
