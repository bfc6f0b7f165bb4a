"""What a campaign is about to do, how far it is, and what it left, for people and programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.table import Table

from ssp_core import console
from ssp_core.vocabulary import PHASES
from ssp_eval.evaluate.admission import ADMITTED, REFUSED, UNAUDITED
from ssp_eval.evaluate.cell_file import CellResult, holds_answers, losses_text
from ssp_eval.evaluate.plan import NO_CONTROLS, Plan

_WIDEST = 400
# Shown at the end; METHOD 6.14 has all of them.
_COLUMNS = (("JOVR", "jovr"), ("Sem", "sem_acc_eff"), ("CIA", "cia_eff"), ("TQSR", "tqsr"))


@contextmanager
def asking(
    no_controls: str = NO_CONTROLS,
) -> Iterator[tuple[Callable[[Plan], None], Callable[[], None]]]:
    """A progress bar on standard error: what is to be told the plan, and each label time.

    Args:
        no_controls: what leaves the controls out, for the line that tells what is asked.
    """
    with console.progress("asking", None) as bar:
        task = bar.task_ids[0]

        def on_plan(plan: Plan) -> None:
            for line in plan.label_lines:
                console.note(f"labels in {'/'.join(PHASES)}, {line}")
            console.note(plan.line(no_controls))
            bar.update(task, total=plan.label_times)

        yield on_plan, lambda: bar.advance(task)


@contextmanager
def kept_on_interrupt(out: Path) -> Iterator[None]:
    """Tells somebody who interrupts a campaign that its answers are kept."""
    try:
        yield
    except KeyboardInterrupt:
        if holds_answers(out):
            console.note(f"the answers so far are in {out}; the same command, given again, goes on")
        raise


def show(results: Sequence[CellResult], out: Path) -> None:
    """The table at the end of a campaign, and a line for each cell that lacks something."""
    table = Table(box=None, pad_edge=False)
    for name in ("scenario", "domain", "model", "status", "audit"):
        table.add_column(name, no_wrap=True)
    for name in ("n", "missing", *(title for title, _ in _COLUMNS), "risk", "IVCS"):
        table.add_column(name, justify="right", no_wrap=True)
    for result in results:
        table.add_row(
            result.scenario,
            result.domain,
            result.model,
            result.status,
            result.admission,
            *_numbers(result),
        )
    # A narrow terminal or a pipe gets long lines rather than cut names.
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print(table)
    for result in results:
        place = f"{result.scenario}/{result.domain}/{result.model}"
        if result.reasons:
            console.note(f"{place}: {result.status}: {'; '.join(result.reasons)}")
        elif result.missing:
            first = result.first_missing
            console.note(f"{place}: {losses_text(result.losses)}; first: {first} (see cell.json)")
        if result.admission == UNAUDITED and result.admission_reasons:
            why = "; ".join(result.admission_reasons)
            console.note(f"{place}: counts as unaudited, audit it again: {why}")
    stored = sum(result.reused for result in results)
    if stored:
        sent = sum(result.asked for result in results)
        console.note(f"asked: {sent}; answers that were stored already: {stored}")
    outside = sorted({r.admission for r in results} - {ADMITTED, REFUSED})
    if outside:
        console.note(f"{' and '.join(outside)} recordings stay out of domain means")
    console.note(f"written to {out}; `ssp report {out}` makes a page of it")


def _numbers(result: CellResult) -> list[str]:
    score = result.score
    if score is None:
        return ["–"] * (len(_COLUMNS) + 4)
    cells = [f"{score['n']}", f"{result.missing or '·'}"]
    for _, key in _COLUMNS:
        cells.append("–" if score[key] is None else f"{score[key]:.2f}")
    risk = f"S@{score['rl_s']:.2f}" if score["rsr"] else "F"
    return [*cells, risk, f"{score['ivcs']:.3f}"]


def result_to_json(result: CellResult) -> dict[str, Any]:
    """A cell as ``--json`` prints it."""
    return {
        "cell": result.folder.name,
        "scenario": result.scenario,
        "domain": result.domain,
        "model": result.model,
        "control": result.control,
        "status": result.status,
        "admission": result.admission,
        "admission_reasons": list(result.admission_reasons),
        "reasons": list(result.reasons),
        "sent": result.asked,
        "reused": result.reused,
        "asked_again": result.again,
        "missing": result.missing,
        "missing_by_kind": dict(result.losses),
        "labels_per_phase": dict(result.labels_per_phase),
        "score": result.score,
    }
