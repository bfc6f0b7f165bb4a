"""The report of a campaign of driven runs: one self-contained page in its folder."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ssp_core.files.writing import write_text
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_core.templates import templates
from ssp_eval.closed_loop.comparisons import LEAST_EVENTS
from ssp_eval.closed_loop.figures import (
    SHARES,
    Chain,
    chains_of,
    class_of,
    counts_of,
    outcome_plot,
)
from ssp_eval.closed_loop.folder import LoopCampaign, Run
from ssp_eval.closed_loop.tables import (
    headline_table,
    other_starts_table,
    outcome_table,
    over_events_table,
    pair_table,
    severity_table,
    unlike_pair_table,
)
from ssp_eval.pages import style
from ssp_eval.score.cli import NULL
from ssp_eval.statistics.table import Table, counted
from ssp_eval.statistics.tables.grids import Grid, grid
from ssp_scenario_manager.closed_loop.campaigns.groups import headings_of
from ssp_scenario_manager.closed_loop.campaigns.plan_file import BASELINES, PRIVILEGED, ZERO
from ssp_scenario_manager.closed_loop.campaigns.row_bags import bag_folder
from ssp_scenario_manager.closed_loop.campaigns.runs import jobs_of
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS
from ssp_scenario_manager.closed_loop.outcomes.rates import refusal_reasons, rising
from ssp_scenario_manager.closed_loop.outcomes.tables import off_the_twin

PAGE = "index.html"
_HERE = Path(__file__).parent
# Failed runs of one driver that the page lists.
MOST_FAILED = 60
# Fewer critical starts leave an interval that says little.
FEW_STARTS = 10


def write_loop_report(campaign: LoopCampaign, further: Sequence[Table] = ()) -> Path:
    """Write the page of a campaign into its folder.

    Args:
        campaign: of driven runs.
        further: tables on words and deeds, and on the open loop.
    """
    target = campaign.folder / PAGE
    write_text(target, render(campaign, further))
    return target


def tables_of(campaign: LoopCampaign) -> list[Table]:
    """Return all tables of a campaign, for files; those of a group of drivers have its number."""
    tables, rates = [], campaign.rates
    for k, group in campaign.groups.items():
        others = [one for one in campaign.drivers if one not in group]
        own = [
            *(severity_table(campaign, event, group) for event in campaign.plan.events),
            *(headline_table(campaign, event, group) for event in campaign.plan.events),
            *(outcome_table(rates, event, group) for event in campaign.plan.events),
            other_starts_table(campaign, group),
            over_events_table(campaign, group),
            pair_table(campaign, group),
            unlike_pair_table(campaign, group, others),
        ]
        tables += [replace(one, name=f"{one.name}_{k}") for one in own]
    return tables


def render(campaign: LoopCampaign, further: Sequence[Table] = ()) -> str:
    """Return the page of a campaign as HTML; see write_loop_report."""
    groups = list(campaign.groups.values())
    critical = [one for one in campaign.starts if one["kind"] == "critical"]
    own = [one for one in campaign.drivers if one not in BASELINES]
    there = counts_of(campaign.critical)
    return (
        templates(_HERE)
        .get_template("page.html.j2")
        .render(
            style=style(_HERE / "style.css"),
            campaign=campaign,
            events=campaign.plan.events,
            critical_starts=len(critical),
            other_starts=len(campaign.starts) - len(critical),
            own_drivers=own,
            baselines=len(campaign.drivers) - len(own),
            planned=planned_of(campaign),
            notices=notices_of(campaign),
            privileged=[one["driver"] for one in campaign.cards if one["privileged"]],
            shares=[
                {"name": share.replace("_", " "), "class": class_of(share)}
                for share in SHARES
                if there[share]
            ],
            parts=[_part(campaign, event, groups) for event in campaign.plan.events],
            over_events=[grid(over_events_table(campaign, group)) for group in groups],
            others=_others(campaign, groups),
            pairs=_pairs(campaign, groups, own),
            further=[grid(table) for table in further],
            failed=failed_of(campaign),
            most=MOST_FAILED,
            again=lambda run: again(campaign, run),
            bag=lambda run: bag_of(campaign, run),
            rows_of=card_rows,
        )
    )


def _part(campaign: LoopCampaign, event: str, groups: list[list[str]]) -> dict[str, Any]:
    rates = [one for one in campaign.rates if one.event == event]
    runs = [one for one in campaign.critical if one.row.event == event]
    headings = headings_of(campaign.cards)
    sections = []
    for k, group in campaign.groups.items():
        drivers = [one for one in group if any(run.row.driver == one for run in runs)]
        if drivers:
            plots = [
                (
                    driver,
                    Markup(
                        outcome_plot(
                            driver,
                            [run for run in runs if run.row.driver == driver],
                            sorted(
                                (one for one in rates if one.driver == driver),
                                key=lambda one: one.latency,
                            ),
                        )
                    ),
                )
                for driver in drivers
            ]
            sections.append(
                {
                    "conditions": f"Group {k}: {headings[k - 1]}",
                    "headline": grid(headline_table(campaign, event, drivers)),
                    "outcomes": grid(outcome_table(rates, event, drivers)),
                    "plots": plots,
                }
            )
    chains = chains_of(campaign, event)
    draw = next(one for one in campaign.draws if one.event == event)
    return {
        "event": event,
        "drawn": draw.words,
        "left_out": draw.left_out,
        "groups": sections,
        "chains": [_with_words(chain) for chain in chains],
        "longest_s": max([chain.whole_s for chain in chains], default=0.0) or 1.0,
        "severity": _severity(campaign, event, groups),
    }


def _severity(campaign: LoopCampaign, event: str, groups: list[list[str]]) -> list[Grid]:
    """Return the tables of one event, with the note under the last one alone."""
    return _noted([severity_table(campaign, event, group) for group in groups])


def _others(campaign: LoopCampaign, groups: list[list[str]]) -> list[Grid]:
    """Return the tables of starts that aren't critical, with the note under the last one alone."""
    return _noted([other_starts_table(campaign, group) for group in groups])


def _noted(tables: Sequence[Table]) -> list[Grid]:
    grids = [grid(table) for table in tables if table.rows]
    return [*(replace(one, notes=()) for one in grids[:-1]), *grids[-1:]]


def _pairs(campaign: LoopCampaign, groups: list[list[str]], own: list[str]) -> list[Grid]:
    """Return the pairs with one of the plan's own drivers; of baselines alone where it has none."""
    tables = [pair_table(campaign, group, own or None) for group in groups]
    tables += [_unlike(campaign, group, own) for group in groups]
    return [grid(table) for table in tables if table.rows]


def _unlike(campaign: LoopCampaign, group: list[str], own: list[str]) -> Table:
    drivers = [one for one in group if one in own]
    others = [one for one in campaign.drivers if one not in group and one not in PRIVILEGED]
    return unlike_pair_table(campaign, drivers, others)


def _with_words(chain: Chain) -> dict[str, Any]:
    durations = (
        *(("frame", chain.wait_s), ("question", chain.open_s)),
        *(("answer", chain.answer_s), ("response", chain.response_s)),
    )
    words = [f"{name} {value:+.2f} s" for name, value in durations if value is not None]
    description = ", ".join(words) if words else "not asked after T_obs"
    if chain.responded < chain.runs:
        description += f"; no response in {chain.runs - chain.responded} of {chain.runs}"
    return {
        "driver": chain.driver,
        "latency": chain.latency,
        "parts": chain.parts,
        "told": description,
    }


def planned_of(campaign: LoopCampaign) -> int:
    """Return how many runs the campaign will have."""
    jobs = sum(1 for _ in jobs_of(campaign.plan, campaign.starts))
    return jobs * len(campaign.plan.latencies) * campaign.plan.repeats


def notices_of(campaign: LoopCampaign) -> list[tuple[str, bool]]:
    """Return what must be read before the numbers, each with whether it is strong."""
    plan, rates = campaign.plan, campaign.rates
    notices = [
        (
            "Outcomes hold for these events, places and starts. Objects don't react to the VUT. "
            "No headline says that a model may drive a vehicle.",
            True,
        )
    ]
    run_count, planned = len(campaign.runs), planned_of(campaign)
    if run_count < planned:
        notices.append((f"Only {run_count} of {planned} runs are done: rates will change.", True))
    notices += [
        (f"The campaign is refused: {text}.", True) for text in refusal_reasons(rates, ZERO)
    ]
    notices += [
        (f"Gets better with latency: {text}.", True) for text in rising(rates, campaign.drivers)
    ]
    off = off_the_twin(one.cells for one in campaign.runs)
    notices += [(f"Differs from no_response: {text}.", True) for text in off]
    for one in rates:
        if one.headline is None:
            lost = one.planned - one.driven
            notices.append(
                (
                    f"{one.driver} on {one.event} at {one.latency.words} has no rate: SSP "
                    f"failed in {lost} of {one.planned} runs.",
                    True,
                )
            )
        if one.starved:
            notices.append(
                (
                    f"{one.driver} on {one.event} at {one.latency.words} is starved in "
                    f"{one.starved} of {one.planned} runs: its plans end before the next one can "
                    "take effect. It is shown, not ranked.",
                    False,
                )
            )
    notices += [(text, False) for text in _early(campaign)]
    if plan.starts < FEW_STARTS:
        starts = counted(plan.starts, "critical start")
        notices.append((f"Intervals are wide: {starts} per event.", False))
    if len(plan.events) < LEAST_EVENTS:
        notices.append(
            (f"{counted(len(plan.events), 'event')}: no interval covers other events.", False)
        )
    return notices


def _early(campaign: LoopCampaign) -> list[str]:
    """Say of each driver that was off its twin before a frame after T_obs was answered.

    A VUT that is a little slower before the event meets the object at another moment. It is
    ``evaded`` only where it then has no contact when it goes on (``outcomes.evaded``).
    """
    successes: dict[tuple[str, str, Latency], list[bool]] = {}
    for run in campaign.critical:
        response_s, effective_s = run.value("response_s"), run.value("effective_s")
        if run.row.succeeds and response_s is not None and effective_s is not None:
            cell = run.row.event, run.row.driver, run.row.latency
            successes.setdefault(cell, []).append(response_s < effective_s)
    return [
        f"{driver} on {event} at {latency.words}: in {sum(early)} of {len(early)} successes the "
        "VUT was off its twin's speed or lane before a frame after T_obs was answered. There, "
        "avoiding the contact needn't be a response to the event."
        for (event, driver, latency), early in successes.items()
        if any(early)
    ]


def failed_of(campaign: LoopCampaign) -> list[tuple[str, list[Run]]]:
    """Return by driver its runs that are no success, those of the plan's own drivers first."""
    drivers = sorted(
        (one for one in campaign.drivers if one not in ZERO), key=lambda one: one in BASELINES
    )
    failures = []
    for driver in drivers:
        runs = [r for r in campaign.critical if r.row.driver == driver and not r.row.succeeds]
        if runs:
            failures.append((driver, sorted(runs, key=lambda r: r.row.outcome != HARNESS)))
    return failures


def again(campaign: LoopCampaign, run: Run) -> str:
    """Return the command that drives one run again; empty: it is of no session."""
    if campaign.card(run.row.driver)["kind"] == CAREFUL:
        return ""
    return f"ssp loop {shlex.quote(str(campaign.folder))} --again {run.number}"


def bag_of(campaign: LoopCampaign, run: Run) -> str:
    """Return the place of a run's bag in the campaign's folder; empty: it has no complete one."""
    folder = bag_folder(campaign.folder, run.number)
    # The last file that is written.
    is_complete = (folder / RESULT_FILE).is_file()
    return str((folder / "bag").relative_to(campaign.folder)) if is_complete else ""


def card_rows(card: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return a card as rows of words."""
    rows = []
    for key, value in card.items():
        if key == "latencies":
            rows += [(f"L {one['given']}", _latency_words(one)) for one in value]
        elif isinstance(value, Mapping):
            rows += [(f"{key}: {name}".replace("_", " "), _words(v)) for name, v in value.items()]
        else:
            rows.append((key.replace("_", " "), _words(value)))
    return rows


def _latency_words(latency: Mapping[str, Any]) -> str:
    if latency["p50_s"] is None:
        # A measured L has a number of answers once all runs are done.
        unknown = latency.get("answers", 0) is None
        return (
            f"measured, not known until all runs are done; {latency['contains']}"
            if unknown
            else f"{NULL}, nothing was asked"
        )
    words = f"p50 {latency['p50_s']:.3g} s, p99 {latency['p99_s']:.3g} s, {latency['contains']}"
    if "answers" not in latency:
        return words
    return (
        f"{words}; {counted(latency['answers'], 'answer')}, medians of the parts: encoding "
        f"{latency['encoding_p50_s']:.3g} s, transport and inference "
        f"{latency['transport_and_inference_p50_s']:.3g} s, parsing "
        f"{latency['parsing_p50_s']:.3g} s; {latency['over_bound']} above the bound"
    )


def _words(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(one)}" for name, one in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(_words, value)) or "none"
    return str(value)
