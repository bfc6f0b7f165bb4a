"""A campaign as command line and node run it: over topics or processes, with a progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

from rich.table import Table

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import taken_folder
from ssp_core.host.ray_cluster import import_ray
from ssp_core.host.terminal import pasteable
from ssp_core.vocabulary import PHASES
from ssp_eval.data.labels import labels_version
from ssp_eval.data.provenance import find_labels
from ssp_eval.evaluate.bridges import TopicClients
from ssp_eval.evaluate.campaign import (
    NO_CONTROLS,
    Plan,
    models_of,
    open_clips,
    plan_of,
    run_campaign,
)
from ssp_eval.evaluate.cell import fail_cell
from ssp_eval.evaluate.clients.model_client import ClientsWithAnswerers
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conditions.design import series_of
from ssp_eval.evaluate.executors import Job, Settings, run_pool, run_ray
from ssp_eval.evaluate.store.admission import ADMITTED, REFUSED, UNAUDITED, Admission, keep_audits
from ssp_eval.evaluate.store.cell_file import CellResult, LabelledClip, holds_answers, losses_text
from ssp_eval.score.cli import format_response
from ssp_eval.score.metrics import COMPONENTS, METRIC_LABELS

_WIDEST = 400
# Shown at the end beside response and IVCS; METHOD 6.14 has all of them.
_SHOWN = COMPONENTS[:4]


@contextmanager
def asking(
    no_controls: str = NO_CONTROLS,
) -> Iterator[tuple[Callable[[Plan], None], Callable[[], None]]]:
    """Yield a progress bar on standard error: functions that take the plan, and each label time.

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
def interrupt_notice(out: Path) -> Iterator[None]:
    """Tell a user who interrupts a campaign that its answers are kept."""
    try:
        yield
    except KeyboardInterrupt:
        if holds_answers(out):
            console.note(f"the answers so far are in {out}; the same command, given again, goes on")
        raise


def show(results: Sequence[CellResult], out: Path) -> None:
    """Print the table at the end of a campaign, and a line for each cell that lacks something."""
    table = Table(box=None, pad_edge=False)
    for name in ("scenario", "domain", "model", "status", "audit"):
        table.add_column(name, no_wrap=True)
    for name in ("n", "missing", *(METRIC_LABELS[name] for name in _SHOWN), "risk", "IVCS"):
        table.add_column(name, justify="right", no_wrap=True)
    for result in results:
        table.add_row(
            result.scenario,
            result.domain,
            result.model,
            result.status,
            result.admission + (f", driven by {result.driven_by}" if result.driven_by else ""),
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
        sent = sum(result.sent for result in results)
        console.note(f"asked: {sent}; answers that were stored already: {stored}")
    outside = sorted({r.admission for r in results} - {ADMITTED, REFUSED})
    if outside:
        console.note(f"{' and '.join(outside)} recordings stay out of domain means")
    console.note(f"written to {out}; {pasteable('report', out)} makes a page of it")


def _numbers(result: CellResult) -> list[str]:
    score = result.score
    if score is None:
        return ["–"] * (len(_SHOWN) + 4)
    shares = ["–" if score[key] is None else f"{score[key]:.2f}" for key in _SHOWN]
    risk = format_response(score["rsr"], score["rl_s"])
    return [f"{score['n']}", f"{result.missing or '·'}", *shares, risk, f"{score['ivcs']:.3f}"]


def result_to_json(result: CellResult) -> dict[str, Any]:
    """Return a cell as ``--json`` prints it."""
    return {
        "cell": result.folder.name,
        "scenario": result.scenario,
        "domain": result.domain,
        "model": result.model,
        "control": result.control,
        "status": result.status,
        "admission": result.admission,
        "admission_reasons": list(result.admission_reasons),
        "driven_by": result.driven_by,
        "reasons": list(result.reasons),
        "sent": result.sent,
        "reused": result.reused,
        "asked_again": result.again,
        "missing": result.missing,
        "missing_by_kind": dict(result.losses),
        "labels_per_phase": dict(result.labels_per_phase),
        "score": result.score,
    }


def evaluate_bags(
    bags: Sequence[tuple[Path, Path | None]],
    models: Sequence[ModelSpec],
    settings: Settings,
    propose_labels: bool = False,
    admissions: Mapping[str, Admission] | None = None,
    no_controls: str = NO_CONTROLS,
    twins: bool = False,
) -> list[CellResult]:
    """Evaluate every bag with every model, one cell after the other.

    Args:
        bags: bag and its labels file (None: look beside it).
        models: as they are asked, conditions included.
        settings: folder, timeouts and options of the campaign.
        propose_labels: propose labels for each bag that has none.
        admissions: what audits say, by hash of the bag.
        no_controls: what leaves the controls out, for the line that tells what is asked.
        twins: ask about the twins beside the recordings as well.

    Raises:
        InputError: a bag, its labels or an option is wrong.
    """
    attached = any(model.attached for model in models)
    times_s = settings.timeout_s, attached, settings.start_timeout_s
    with (
        asking(no_controls) as (on_plan, on_record),
        TopicClients(settings.out / "logs", *times_s) as topics,
    ):
        return run_campaign(
            bags,
            models,
            ClientsWithAnswerers(topics),
            settings.out,
            settings.options,
            propose_labels,
            admissions,
            on_plan=on_plan,
            on_record=on_record,
            twins=twins,
        )


class Engine(Protocol):
    """Does jobs in other processes; see pool.run_pool."""

    def __call__(
        self,
        jobs: Sequence[Job],
        settings: Settings,
        workers: int,
        on_dead: Callable[[Job, str], list[CellResult]],
        on_record: Callable[[], None],
    ) -> list[CellResult]: ...


ENGINES: dict[str, Engine] = {"processes": run_pool, "ray": run_ray}


def run_parallel(
    bags: Sequence[tuple[Path, Path | None]],
    models: Sequence[ModelSpec],
    settings: Settings,
    workers: int,
    engine: str = "processes",
    propose_labels: bool = False,
    admissions: Mapping[str, Admission] | None = None,
    on_plan: Callable[[Plan], None] = lambda _: None,
    on_record: Callable[[], None] = lambda: None,
    twins: bool = False,
) -> list[CellResult]:
    """Evaluate every bag with every model, several cells at a time.

    Raises:
        InputError: a bag, its labels or an option is wrong, or a bridge is attached.
        HostError: the engine isn't installed, or a worker has another version of the software.
    """
    for model in models:
        model.read_by(settings.options.adapter)
        if model.attached:
            raise InputError(
                "an attached bridge is one, and can't be asked by several workers",
                field="attach",
                value=model.name,
                remedy="leave out --workers and --engine, or let the bridge be started here",
            )
    if engine == "ray":
        import_ray()
    with ExitStack() as stack:
        clips = open_clips(stack, bags, propose_labels, admissions, twins=twins)
        stack.enter_context(taken_folder(settings.out))
        keep_audits(settings.out, (labelled.admission for labelled in clips))
        on_plan(plan_of(clips, models, not settings.options.fresh and holds_answers(settings.out)))
        jobs: list[Job] = []
        clip_of: list[LabelledClip] = []
        for labelled, (bag, labels) in zip(clips, bags, strict=True):
            path = labels or find_labels(bag)
            if path is None:
                raise InputError(
                    "has lost its labels file",
                    file=bag,
                    remedy="put it back, or propose labels with --propose-labels",
                )
            hashes = labelled.clip.provenance.bag_sha256, labels_version(labelled.labels)
            places, admission = (bag.absolute(), path.absolute()), labelled.admission
            for series in series_of(models_of(labelled, models)):
                conditions = {model.condition for model in series} & labelled.twins.keys()
                twins_sha256 = {name: labelled.twins[name].sha256 for name in sorted(conditions)}
                job = Job(len(jobs), *places, tuple(series), *hashes, admission, twins_sha256)
                jobs.append(job)
                clip_of.append(labelled)

        def on_dead(job: Job, reason: str) -> list[CellResult]:
            labelled = clip_of[job.number]
            return [
                fail_cell(labelled, model, settings.out, settings.options, reason)
                for model in job.models
            ]

        return ENGINES[engine](jobs, settings.to_send(), workers, on_dead, on_record)
