"""The outcome of a driven session of several processes.

Its states are those of the same run in one process, to the last bit. That run is driven again, held
against what was recorded, and judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.steps import WorldTick, decode_tick, encode_tick
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import SspError
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.before import Before, failed_for
from ssp_scenario_manager.closed_loop.single import told_of_run
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.run.sweep import for_one_process


def told_of_session(before: Before | None, spec: RunSpec, bag: Path) -> tuple[dict[str, Any], str]:
    """Return what ``result.json`` says of who drove, and why the verdict can't stand.

    Both are empty for a run that nobody drove.

    Args:
        before: what the run was, where it is driven again; None: it is held against nothing.
        spec: as it was driven.
        bag: of the session.
    """
    if spec.driven is None:
        return {}, ""
    run = for_one_process(spec)
    result, record = run_in_process(run)
    told = told_of_run(run, result, record)
    if why := _difference(bag, record.reports):
        told["driven"] |= failed_for(why)
    elif before is not None:
        told["driven"], why = before.judged(told["driven"])
    return told, why


def _difference(bag: Path, reports: Sequence[StepReport]) -> str:
    """Say where a session's true states depart from those of one process; empty: nowhere."""
    try:
        with BagReader(bag) as reader:
            ticks = [
                decode_tick(message.data)
                for message in reader.messages([names.absolute(names.WORLD_TICK)])
            ]
    except (SspError, ValueError) as error:
        return f"the bag can't be read: {error}"
    seen = {tick.step: tick.objects for tick in ticks}
    # The last step of the one is not always one of the other: each sees the end in its own way.
    for report in reports[:-1]:
        if seen.get(report.step) != _as_heard(report):
            at_s = ns_to_seconds(report.now_ns)
            return f"at {at_s:.2f} s the session's states aren't those of one process"
    return ""


def _as_heard(report: StepReport) -> tuple[ObjectState, ...]:
    """Return the true states of a step as its tick carries them."""
    tick = WorldTick(report.now_ns, report.step, report.running, True, 0, 0, report.truths)
    return decode_tick(encode_tick(tick)).objects
