"""The table of a campaign, as JSON for programs, as Markdown for documents, as JUnit for CI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.faults.campaign import CellResult
from ssp_scenario_manager.faults.judge import Judged, Reaction
from ssp_scenario_manager.faults.model import Cell, Expected, NotApplicable, Row, Stage
from ssp_scenario_manager.runner.junit import Case
from ssp_scenario_manager.runner.outcome import Outcome

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
        outcome = Outcome(Verdict.VALID, ())
        if not result.ok:
            outcome = Outcome(Verdict.FAILED_SAFETY, result.judged.findings)
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
