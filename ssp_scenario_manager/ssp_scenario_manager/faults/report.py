"""The table of a campaign as JSON, Markdown and JUnit, and its page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from ssp_core.files import write_text
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.faults.campaign import CellResult
from ssp_scenario_manager.faults.judge import Judged, Reaction
from ssp_scenario_manager.faults.model import Cell, Expected, NotApplicable, Row, Stage
from ssp_scenario_manager.run.junit import Case
from ssp_scenario_manager.session.run_script import RunOutcome

SCHEMA = "ssp.fault_matrix/1"


def as_json(results: Sequence[CellResult]) -> dict[str, Any]:
    """Everything that is known of the cells."""
    return {
        "schema": SCHEMA,
        "as_expected": all(result.ok for result in results),
        "cells": [_cell_json(result) for result in results],
    }


def _cell_json(result: CellResult) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "scenario": result.scenario,
        "mode": result.mode,
        "fault": result.row.name,
        "stage": result.stage.value,
        "applicable": isinstance(result.cell, Expected),
    }
    if isinstance(result.cell, NotApplicable):
        return facts | {"reason": result.cell.reason}
    judged, fault = result.judged, result.fault
    facts |= {
        "expected_verdicts": sorted(result.cell.verdicts),
        "by": result.cell.by,
        "why": result.cell.why,
    }
    if fault is not None:
        facts["injected"] = fault.model_dump(mode="json")
    if judged is None:
        return facts
    reaction = judged.reaction
    return facts | {
        "as_expected": judged.ok,
        "verdict": judged.verdict,
        "primary_reason": judged.primary,
        "reaction": None if reaction is None else _reaction_json(reaction),
        "stops": {
            object_id: {
                "speed_mps": round(stop.speed_mps, 3),
                "distance_m": round(stop.distance_m, 3),
                "bound_m": round(stop.bound_m, 3),
                "standstill_s": stop.standstill_s,
            }
            for object_id, stop in judged.stops.items()
        },
        "findings": list(judged.findings),
        "folder": None if result.folder is None else str(result.folder),
        "wall_s": result.wall_s,
    }


def _reaction_json(reaction: Reaction) -> dict[str, Any]:
    return {
        "seconds": None if reaction.seconds is None else round(reaction.seconds, 4),
        "bound_s": round(reaction.bound_s, 4),
        "clock": reaction.clock,
        "sign": reaction.sign,
    }


# -- words ----------------------------------------------------------------------------------------


def reaction_text(reaction: Reaction) -> str:
    """``0.52 s (≤ 0.56)``."""
    took = "never" if reaction.seconds is None else f"{reaction.seconds:.2f} s"
    wall = " wall" if reaction.clock == "wall" else ""
    return f"{took}{wall} (≤ {reaction.bound_s:.2f})"


def measured_parts(judged: Judged) -> list[str]:
    """Verdict, reaction time and stopping distances, each with its bound."""
    parts = [judged.verdict]
    if judged.reaction is not None:
        parts.append(reaction_text(judged.reaction))
    parts += [
        f"{object_id} {stop.distance_m:.1f} m (≤ {stop.bound_m:.1f})"
        for object_id, stop in judged.stops.items()
        if stop.speed_mps > 0.0 or stop.distance_m > 0.0
    ]
    return parts


def expected_text(cell: Expected) -> str:
    """The allowed verdicts."""
    return " or ".join(sorted(cell.verdicts))


def by_scenario(results: Sequence[CellResult]) -> dict[str, list[CellResult]]:
    """The results of each scenario and mode, in their order."""
    parted: dict[str, list[CellResult]] = {}
    for result in results:
        way = result.mode if result.way == "sessions" else "in one process"
        parted.setdefault(f"{result.scenario}, {way}", []).append(result)
    return parted


def rows_of(results: Sequence[CellResult]) -> dict[str, dict[Stage, CellResult]]:
    """Results by row and stage, in their order."""
    rows: dict[str, dict[Stage, CellResult]] = {}
    for result in results:
        rows.setdefault(result.row.name, {})[result.stage] = result
    return rows


# -- Markdown -------------------------------------------------------------------------------------


def markdown(results: Sequence[CellResult], run: RunSpec) -> str:
    """The measured table of each scenario, and what is expected of each row.

    Args:
        results: of the campaign.
        run: gives the limits that the bounds are made of.
    """
    parts = []
    for title, cells in by_scenario(results).items():
        counted = [c for c in cells if c.judged is not None]
        well = sum(c.ok for c in counted)
        parts.append(f"### {title}\n\n{well} of {len(counted)} cells as expected.\n")
        parts.append(_measured(cells))
    parts.append("### What is expected, and why\n")
    parts.append(_reasons(results, run))
    return "\n".join(parts)


def _measured(cells: Sequence[CellResult]) -> str:
    stages = [s for s in Stage if any(c.stage is s for c in cells)]
    lines = [
        "| fault | " + " | ".join(s.title for s in stages) + " |",
        "| --- |" + " --- |" * len(stages),
    ]
    for name, row in rows_of(cells).items():
        shown = [_measured_cell(row.get(stage)) for stage in stages]
        lines.append(f"| `{name}` | " + " | ".join(shown) + " |")
    return "\n".join(lines) + "\n"


def _measured_cell(result: CellResult | None) -> str:
    if result is None:
        return ""
    if result.judged is None:
        return "not applicable"
    text = "<br>".join(measured_parts(result.judged))
    return text if result.ok else f"**NOT AS EXPECTED**<br>{text}"


def _reasons(results: Sequence[CellResult], run: RunSpec) -> str:
    lines = [
        "| fault | stages | verdict | who reacts | within | why |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in rows_of(results):
        row = next(r.row for r in results if r.row.name == name)
        for stages, cell in expectations(row, results):
            words = ", ".join(stage.title for stage in stages)
            if isinstance(cell, NotApplicable):
                lines.append(f"| `{name}` | {words} | not applicable | | | {cell.reason} |")
                continue
            bound = bound_text(cell, run)
            lines.append(
                f"| `{name}` | {words} | {expected_text(cell)} | {cell.by or '–'} | {bound} | "
                f"{cell.why} |"
            )
    return "\n".join(lines) + "\n"


def expectations(row: Row, results: Sequence[CellResult]) -> list[tuple[list[Stage], Cell]]:
    """The cells of a row that were run, those of several stages once."""
    found: list[tuple[list[Stage], Cell]] = []
    for result in results:
        if result.row is not row:
            continue
        for stages, known in found:
            if known == result.cell:
                if result.stage not in stages:
                    stages.append(result.stage)
                break
        else:
            found.append(([result.stage], result.cell))
    return found


def bound_text(cell: Expected, run: RunSpec) -> str:
    """The bound on the reaction time: what it is made of, and the number."""
    bound = cell.bound(run.mode)
    return "–" if bound is None else f"{bound.text} = {bound.seconds(run):g} s"


# -- JUnit ----------------------------------------------------------------------------------------


def junit_cases(results: Sequence[CellResult]) -> list[Case]:
    """A test case per cell; one that isn't as expected is a failure with its findings."""
    cases = []
    for result in results:
        if result.judged is None:
            continue
        outcome = RunOutcome(Verdict.VALID, ())
        if not result.ok:
            outcome = RunOutcome(Verdict.FAILED_SAFETY, result.judged.findings)
        cases.append(
            Case(
                f"faults.{result.scenario}.{result.mode}",
                f"{result.row.name} {result.stage.title}",
                outcome,
                result.wall_s,
                {"verdict": result.judged.verdict, "reason": result.judged.primary},
            )
        )
    return cases


_STYLE = """
:root { --ink: #1b2430; --soft: #5b6776; --line: #dfe4ea; --good: #e4f2ec; --bad: #fbe0d8;
  --none: #f2f3f5; --rust: #a8380f; --green: #0b6e4f }
* { box-sizing: border-box }
body { margin: 0 auto; max-width: 1320px; padding: 28px 28px 80px; color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif }
h1 { font-size: 28px; margin: 0 0 6px; letter-spacing: -.01em }
h2 { font-size: 20px; margin: 36px 0 2px }
p { max-width: 84ch; color: var(--soft); margin: 4px 0 14px }
dl { display: flex; flex-wrap: wrap; gap: 10px; margin: 14px 0 }
dl div { border: 1px solid var(--line); border-radius: 8px; padding: 6px 16px 8px }
dt { font-size: 12.5px; color: var(--soft) } dd { margin: 0; font-size: 24px; font-weight: 650;
  font-variant-numeric: tabular-nums }
.wrap { overflow-x: auto }
table { border-collapse: separate; border-spacing: 0; font-size: 13.5px; width: 100% }
th { text-align: left; font-size: 12.5px; color: var(--soft); font-weight: 600;
  padding: 6px 10px; border-bottom: 1px solid var(--line); vertical-align: bottom }
td { padding: 7px 10px; border-bottom: 1px solid var(--line); vertical-align: top }
.grid td + td { border-left: 3px solid #fff; min-width: 190px }
.grid td { font-variant-numeric: tabular-nums }
.grid .name { font-weight: 600; min-width: 210px } .name code { display: block; color: var(--soft);
  font-weight: 400; font-size: 12px }
.ok { background: var(--good) } .bad { background: var(--bad) } .na { background: var(--none);
  color: var(--soft) }
.verdict { font-weight: 650 } .ok .verdict { color: var(--green) } .bad .verdict {
  color: var(--rust) }
.figure { display: block; white-space: nowrap }
.why { display: block; color: var(--soft); font-size: 12.5px; max-width: 260px }
ul { margin: 4px 0 0; padding-left: 16px } li { color: var(--rust) }
.plan td:nth-child(6) { max-width: 560px; color: var(--soft) }
.plan td { font-size: 13px } code { font-size: .92em }
"""
_LEAD = (
    "Each fault strikes the session when it is armed, a second before the trigger, between trigger "
    "and conflict, and 0.3 s into the conflict. A cell is as expected when verdict and first "
    "reason are the ones that are written down, the reaction comes within its bound, everything "
    "stops within the stated distance and stays inside the fence, nothing touches, the bag can be "
    "read, and no process and no memory is left behind."
)
_FIGURES = (
    "In a cell: the verdict; the time from the fault to the first answer to it, and its bound; the "
    "way of each object from the fault to its standstill, and its bound "
    "v·(timeout + reaction) + v²/2a + margin."
)


def write_page(path: Path, results: Sequence[CellResult], run: RunSpec) -> None:
    """Writes the page.

    Args:
        path: of the HTML file.
        results: of the campaign.
        run: gives the limits that the bounds are made of.
    """
    write_text(path, page(results, run))


def page(results: Sequence[CellResult], run: RunSpec) -> str:
    """The page as text; arguments as for write_page."""
    counted = [r for r in results if r.judged is not None]
    bad = [r for r in counted if not r.ok]
    figures = [
        ("cells", str(len(counted))),
        ("as expected", str(len(counted) - len(bad))),
        ("not as expected", str(len(bad))),
        ("not applicable", str(len(results) - len(counted))),
    ]
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        "<meta name='color-scheme' content='light'><link rel='icon' href='data:,'>",
        f"<title>SSP fault matrix</title><style>{_STYLE}</style></head><body>",
        f"<h1>Fault matrix</h1><p>{escape(_LEAD)}</p>",
        "<dl>",
        *(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in figures),
        "</dl>",
    ]
    for title, cells in by_scenario(results).items():
        parts += [f"<h2>{escape(title)}</h2><p>{escape(_FIGURES)}</p>", _grid(cells)]
    parts += ["<h2>What is expected, and why</h2>", _plan(results, run), "</body></html>\n"]
    return "\n".join(parts)


def _grid(cells: Sequence[CellResult]) -> str:
    stages = [s for s in Stage if any(c.stage is s for c in cells)]
    head = "".join(f"<th>{s.title}</th>" for s in stages)
    lines = [f"<div class='wrap'><table class='grid'><tr><th>fault</th>{head}</tr>"]
    for name, row in rows_of(cells).items():
        title = escape(next(iter(row.values())).row.title)
        shown = "".join(_cell(row.get(stage)) for stage in stages)
        lines.append(f"<tr><td class='name'>{title}<code>{escape(name)}</code></td>{shown}</tr>")
    return "\n".join([*lines, "</table></div>"])


def _cell(result: CellResult | None) -> str:
    if result is None:
        return "<td class='na'></td>"
    if isinstance(result.cell, NotApplicable):
        reason = escape(result.cell.reason)
        return (
            f"<td class='na'>not applicable<span class='figure why' title='{reason}'></span></td>"
        )
    judged = result.judged
    if judged is None:
        return "<td class='na'>not run</td>"
    verdict, *figures = measured_parts(judged)
    lines = "".join(f"<span class='figure'>{escape(one)}</span>" for one in figures)
    first = judged.primary.splitlines()[0] if judged.primary else ""
    if first:
        lines = f"<span class='why'>{escape(first.partition(':')[0])}</span>{lines}"
    findings = "".join(f"<li>{escape(one)}</li>" for one in judged.findings)
    findings = f"<ul>{findings}</ul>" if findings else ""
    state = "ok" if judged.ok else "bad"
    return (
        f"<td class='{state}' title='{escape(first, quote=True)}'><span class='verdict'>"
        f"{escape(verdict)}</span>{lines}{findings}</td>"
    )


def _plan(results: Sequence[CellResult], run: RunSpec) -> str:
    lines = [
        "<div class='wrap'><table class='plan'><tr><th>fault</th><th>stages</th><th>verdict</th>"
        "<th>who reacts</th><th>within</th><th>why</th></tr>"
    ]
    for name in rows_of(results):
        row = next(r.row for r in results if r.row.name == name)
        for stages, cell in expectations(row, results):
            words = ", ".join(stage.title for stage in stages)
            lines.append(f"<tr><td><code>{escape(name)}</code></td><td>{words}</td>")
            if isinstance(cell, Expected):
                columns = [expected_text(cell), cell.by or "–", bound_text(cell, run), cell.why]
            else:
                columns = ["not applicable", "–", "–", cell.reason]
            lines.append("".join(f"<td>{escape(text)}</td>" for text in columns) + "</tr>")
    return "\n".join([*lines, "</table></div>"])
