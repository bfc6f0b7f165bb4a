"""``ssp run --in-process``: what the command line does with one run, and with a sweep."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_json, write_text
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.in_process.outcome import (
    InProcessResult,
    result_json,
    run_in_process,
    save_states,
)
from ssp_scenario_manager.in_process.sweep import ROWS_FILE, Row, Sweep, run_sweep
from ssp_scenario_manager.in_process.vary import Span, grid, parse_variation
from ssp_scenario_manager.runner.happened import shown_gap
from ssp_scenario_manager.runner.inject import RUNNER_KINDS, with_conditions_never_met

# Of the faults that the runner injects, the session itself can do these.
_IN_PROCESS = ("operator_abort", "trigger_never")


def for_one_process(spec: RunSpec) -> RunSpec:
    """The run as it is done in one process: without a camera, and with triggers that fail.

    Raises:
        InputError: a fault needs processes of their own.
    """
    for index, fault in enumerate(spec.faults):
        if fault.kind in RUNNER_KINDS and fault.kind not in _IN_PROCESS:
            raise InputError(
                f"{fault.kind} needs processes of their own",
                field=f"faults[{index}].kind",
                remedy="leave out --in-process, or this fault",
            )
    return with_conditions_never_met(spec.model_copy(update={"camera": None}))


def run_one(spec: RunSpec, folder: Path, as_json: bool) -> dict[str, Any]:
    """One run; leaves run.yaml, states.npz and result.json. Gives what stands in the last.

    Args:
        spec: as ``for_one_process`` gives it.
        folder: is there.
        as_json: the result on standard output as JSON.
    """
    write_text(folder / "run.yaml", spec.model_dump_json(by_alias=True, indent=1) + "\n")
    result, record = run_in_process(spec)
    for line in _told(spec, result):
        console.note(line)
    written = result_json(spec, result)
    # Said first: the disk may be full.
    if as_json:
        click.echo(json.dumps(written))
    else:
        shown = shown_gap(written["time_gap_s"])
        console.out.print(
            f"{spec.scenario} on {spec.site}: {written['verdict']}, {result.session_s:.1f} s of "
            f"session, {shown}, {folder / 'result.json'}",
            markup=False,
        )
        for reason in result.reasons:
            console.out.print(f"  because {reason}", markup=False)
    save_states(folder / "states.npz", spec, record)
    write_json(folder / "result.json", written)
    return written


def _told(spec: RunSpec, result: InProcessResult) -> list[str]:
    """What happened and when, and faults that were asked for and never came."""
    lines = [
        (p.stamp_ns, f"phase {p.phase.name.lower()} at {ns_to_seconds(p.stamp_ns):.2f} s")
        for p in result.phases
    ]
    lines += [
        (
            f.stamp_ns,
            f"FAULT {f.fault.partition(' ')[2]} of {f.target} {'begins' if f.active else 'ends'} "
            f"({ns_to_seconds(f.stamp_ns):.2f} s)",
        )
        for f in result.faults
    ]
    begun = {f.fault for f in result.faults}
    late = [
        f"fault {i}, {fault.kind} of {fault.target}, did not begin: the run ended before "
        f"{fault.at_s:g} s"
        for i, fault in enumerate(spec.faults)
        if fault.kind not in RUNNER_KINDS and fault.at_s is not None
        if f"{i} {fault.kind}" not in begun
    ]
    return [text for _, text in sorted(lines, key=lambda line: line[0])] + late


def run_many(
    spec: RunSpec, folder: Path, vary: tuple[str, ...], runs: int | None, jobs: int, as_json: bool
) -> int:
    """A sweep; leaves run.yaml, sweep.json and runs.csv. Exit status 0 when all runs are valid."""
    spec = for_one_process(spec)
    variations = tuple(parse_variation(text) for text in vary)
    if runs is None and any(isinstance(v, Span) for v in variations):
        raise InputError(
            "a range has no number of values",
            field="--vary",
            value=", ".join(vary),
            remedy="say with --runs how many are drawn",
        )
    sweep = Sweep(spec, variations, runs if runs is not None else len(grid(variations)))
    sweep.check()
    make_folder(folder)
    verdicts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    with console.progress("runs", sweep.runs) as bar:

        def count(row: Row) -> None:
            verdicts[row[sweep.header.index("verdict")]] += 1
            if reason := row[sweep.header.index("reason")]:
                # Up to the name of the limit; what was measured differs from run to run.
                reasons[reason.partition(":")[0]] += 1
            bar.advance(bar.task_ids[0])

        rows = run_sweep(sweep, folder, jobs, count)
    if as_json:
        click.echo(json.dumps([dict(zip(sweep.header, row, strict=True)) for row in rows]))
    else:
        parts = ", ".join(f"{count} {name}" for name, count in sorted(verdicts.items()))
        console.out.print(
            f"{spec.scenario} on {spec.site}: {len(rows)} runs, {parts}, {folder / ROWS_FILE}",
            markup=False,
        )
        for reason, count_of in sorted(reasons.items()):
            console.out.print(f"  {count_of} because {reason}", markup=False)
    return 0 if set(verdicts) <= {"valid"} else 1
