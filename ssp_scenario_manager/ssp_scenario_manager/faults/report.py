"""The fault matrix as measured: JSON and JUnit XML for programs, a page for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.faults.campaign import CellResult
from ssp_scenario_manager.faults.judge import CellJudgement
from ssp_scenario_manager.faults.matrix import Cell, NotApplicable, Stage
from ssp_scenario_manager.run.junit import Case
from ssp_scenario_manager.session.run_script import RunOutcome

SCHEMA = "ssp.fault_matrix/1"
_TEMPLATES = Path(__file__).parent.parent / "library" / "templates"


def as_json(results: Sequence[CellResult]) -> dict[str, Any]:
    """Return everything that is known of the cells."""
    return {
        "schema": SCHEMA,
        "as_expected": all(result.ok for result in results),
        "cells": [_cell_json(result) for result in results],
    }


def _cell_json(result: CellResult) -> dict[str, Any]:
    cell, judgement, fault = result.cell, result.judgement, result.fault
    facts: dict[str, Any] = {
        "scenario": result.scene.name,
        "mode": result.scene.mode,
        "fault": result.row.name,
        "stage": result.stage.value,
        "applicable": not isinstance(cell, NotApplicable),
    }
    if isinstance(cell, NotApplicable):
        return facts | {"reason": cell.reason}
    facts |= {"expected_verdicts": sorted(cell.verdicts), "by": cell.by, "why": cell.why}
    if fault is not None:
        facts["injected"] = fault.model_dump(mode="json")
    if judgement is None:
        return facts
    reaction = judgement.reaction
    return facts | {
        "as_expected": judgement.ok,
        "verdict": judgement.verdict,
        "primary_reason": judgement.primary,
        "reaction": None
        if reaction is None
        else {
            "seconds": None if reaction.seconds is None else round(reaction.seconds, 4),
            "bound_s": round(reaction.bound_s, 4),
            "clock": reaction.clock,
            "sign": reaction.sign,
        },
        "stops": {
            object_id: {
                "speed_mps": round(stop.speed_mps, 3),
                "distance_m": round(stop.distance_m, 3),
                "bound_m": round(stop.bound_m, 3),
                "standstill_s": stop.standstill_s,
            }
            for object_id, stop in judgement.stops.items()
        },
        "findings": list(judgement.findings),
        "folder": None if result.folder is None else str(result.folder),
        "wall_s": result.wall_s,
    }


def measured_parts(judgement: CellJudgement) -> list[str]:
    """Return verdict, reaction time and stopping distances, each with its bound."""
    parts = [judgement.verdict]
    if judgement.reaction is not None:
        reaction = judgement.reaction
        took = "never" if reaction.seconds is None else f"{reaction.seconds:.2f} s"
        wall = " wall" if reaction.clock == "wall" else ""
        parts.append(f"{took}{wall} (≤ {reaction.bound_s:.2f})")
    parts += [
        f"{object_id} {stop.distance_m:.1f} m (≤ {stop.bound_m:.1f})"
        for object_id, stop in judgement.stops.items()
        if stop.speed_mps > 0.0 or stop.distance_m > 0.0
    ]
    return parts


# -- for people -----------------------------------------------------------------------------------


def _scenarios(results: Sequence[CellResult]) -> list[dict[str, Any]]:
    """Collect for each scenario and mode its title, its stages, and by row the results by stage."""
    scenarios: dict[str, dict[str, Any]] = {}
    for result in results:
        way = result.scene.mode if result.scene.way == "sessions" else "in one process"
        title = f"{result.scene.name}, {way}"
        scenario = scenarios.setdefault(title, {"title": title, "stages": [], "rows": {}})
        row = scenario["rows"].setdefault(result.row.name, {"title": result.row.title, "cells": {}})
        row["cells"][result.stage] = result
    for scenario in scenarios.values():
        rows = scenario["rows"].values()
        scenario["stages"] = [s for s in Stage if any(s in row["cells"] for row in rows)]
    return list(scenarios.values())


def _expectations(results: Sequence[CellResult], run: RunSpec) -> list[tuple[str, list[str]]]:
    """Collect by row: stages, reacting participant, limit and reason.

    Equal cells of stages once.
    """
    cells_by_row: dict[str, list[tuple[Cell, list[Stage]]]] = {}
    for result in results:
        cells = cells_by_row.setdefault(result.row.name, [])
        stages = next((stages for cell, stages in cells if cell == result.cell), None)
        if stages is None:
            cells.append((result.cell, [result.stage]))
        elif result.stage not in stages:
            stages.append(result.stage)
    return [
        (name, [", ".join(stage.title for stage in stages), *_expected(cell, run)])
        for name, cells in cells_by_row.items()
        for cell, stages in cells
    ]


def _expected(cell: Cell, run: RunSpec) -> list[str]:
    if isinstance(cell, NotApplicable):
        return ["not applicable", "–", "–", cell.reason]
    bound = cell.bound(run.mode)
    within = "–" if bound is None else f"{bound.text} = {bound.seconds(run):g} s"
    return [" or ".join(sorted(cell.verdicts)), cell.by or "–", within, cell.why]


def page(results: Sequence[CellResult], run: RunSpec) -> str:
    """Render the measured table of each scenario, and what each row expects, as HTML.

    Args:
        results: of all cells, those that don't apply included.
        run: gives the limits that the bounds are made of.
    """
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    counted = [result for result in results if result.judgement is not None]
    well = sum(result.ok for result in counted)
    return templates.get_template("fault_matrix.html.j2").render(
        counts={
            "cells": len(counted),
            "as expected": well,
            "not as expected": len(counted) - well,
            "not applicable": len(results) - len(counted),
        },
        scenarios=_scenarios(results),
        expectations=_expectations(results, run),
        measured_parts=measured_parts,
    )


def junit_cases(results: Sequence[CellResult]) -> list[Case]:
    """Return a test case per cell; an unexpected one is a failure with its findings."""
    return [
        Case(
            f"faults.{result.scene.name}.{result.scene.mode}",
            f"{result.row.name} {result.stage.title}",
            RunOutcome(Verdict.VALID, ())
            if result.ok
            else RunOutcome(Verdict.FAILED_SAFETY, result.judgement.findings),
            result.wall_s,
            {"verdict": result.judgement.verdict, "reason": result.judgement.primary},
        )
        for result in results
        if result.judgement is not None
    ]
