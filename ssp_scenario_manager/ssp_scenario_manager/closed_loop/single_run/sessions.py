"""The outcome of a driven session of several processes.

Its states are those of the same run in one process, to the last bit. That run is driven again, held
against what was recorded, and judged. An operator's abort is in no run but the recorded one: up to
it the two are held against each other, and it is the last fact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.steps import WorldTick, decode_tick, encode_tick
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import SspError
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_core.world.driver_answers import NODE_ANSWERS_FILE, given_answers
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.answers import KeptAnswers, Question
from ssp_scenario_manager.closed_loop.single_run.before import Before, failed_for
from ssp_scenario_manager.closed_loop.single_run.single import driven_run_summary, repeats_answers
from ssp_scenario_manager.closed_loop.single_run.top_view import leave_view
from ssp_scenario_manager.closed_loop.starts.start import without_operator
from ssp_scenario_manager.run.in_process import Record, run_in_process
from ssp_scenario_manager.run.sweep import for_one_process


def session_summary(
    before: Before | None, model_answers: KeptAnswers | None, spec: RunSpec, bag: Path
) -> tuple[dict[str, Any], str]:
    """Return what ``result.json`` says of who drove, and why the verdict can't stand.

    Both are empty for a run without a driver. The view from above is left beside the bag where the
    states are those of one process, and no operator cut them off.

    Args:
        before: what the run was, where it is driven again; None: it is held against nothing.
        model_answers: answers that a model repeated; None: it was asked.
        spec: as it was driven.
        bag: of the session, in the folder where its driver's node left its answers.
    """
    if spec.driven is None:
        return {}, ""
    sees = repeats_answers(spec.driven)
    run = without_operator(for_one_process(spec, camera=sees))
    answers = given_answers(bag.parent / NODE_ANSWERS_FILE) if sees else None
    result, record = run_in_process(run, answers=answers)
    session = _session_of(bag)
    abort = None if isinstance(session, str) else session.abort
    if abort is not None:
        record = Record([one for one in record.reports if one.now_ns <= abort.at_ns])
        result = replace(
            result, verdict=Verdict.ABORTED, reasons=abort.reasons, aborted_ns=abort.at_ns
        )
        if model_answers is None and answers is not None:
            # Who aborts a session waits for no model: it isn't asked in the event-free twin.
            model_answers = KeptAnswers(Question.of(spec.driven), answers, ())
    summary, contact = driven_run_summary(
        run, result, record, folder=bag.parent, model_answers=model_answers
    )
    if model_answers is not None and not model_answers.free:
        summary["driven"]["needless"] = (
            "the operator aborted, and the model wasn't asked without the event"
        )
    why = session if isinstance(session, str) else _difference(session.truths, record.reports)
    if why:
        summary["driven"] |= failed_for(why)
    elif abort is None:
        if before is not None:
            summary["driven"], why = before.judge(summary["driven"])
        leave_view(bag.parent, run, record, summary["driven"], contact)
    return summary, why


@dataclass(frozen=True, slots=True)
class _Abort:
    """An operator's abort, and the reasons of the session's verdict."""

    at_ns: int
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _SessionRecord:
    """The true states of a session by step, and the operator's abort; None: there was none."""

    truths: dict[int, tuple[ObjectState, ...]]
    abort: _Abort | None


def _session_of(bag: Path) -> _SessionRecord | str:
    """Read a session's bag; or say why it can't be read."""
    try:
        with BagReader(bag) as reader:
            ticks = [
                decode_tick(message.data)
                for message in reader.messages([names.absolute(names.WORLD_TICK)])
            ]
            states = [
                reader.decode(message)
                for message in reader.messages([names.absolute(names.SESSION_STATE)])
            ]
    except (SspError, ValueError) as error:
        return f"the bag can't be read: {error}"
    return _SessionRecord({tick.step: tick.objects for tick in ticks}, _abort_of(states))


def _abort_of(states: Sequence[Any]) -> _Abort | None:
    aborting = [one for one in states if one.state == SessionPhase.ABORTING]
    # A limit that ended the session before has a verdict of its own.
    if not aborting or states[-1].verdict != Verdict.ABORTED:
        return None
    reasons = tuple(str(reason) for reason in states[-1].reasons)
    return _Abort(stamp_ns(aborting[0].header.stamp), reasons)


def _difference(
    truths_by_step: Mapping[int, tuple[ObjectState, ...]], reports: Sequence[StepReport]
) -> str:
    """Say where a session's true states depart from those of one process; empty: nowhere."""
    # The last step of the one is not always one of the other: each sees the end in its own way.
    for report in reports[:-1]:
        if truths_by_step.get(report.step) != _transmitted_truths(report):
            at_s = ns_to_seconds(report.now_ns)
            return f"at {at_s:.2f} s the session's states aren't those of one process"
    return ""


def _transmitted_truths(report: StepReport) -> tuple[ObjectState, ...]:
    """Return the true states of a step as its tick carries them."""
    tick = WorldTick(report.now_ns, report.step, report.running, True, 0, 0, report.truths)
    return decode_tick(encode_tick(tick)).objects
