"""A campaign over several processes: the same cells as one process gives, byte for byte.

Only ids and latencies differ, as they do between any two runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from ssp_core.errors import InputError
from ssp_eval.evaluate.admission import Admission, keep_audits
from ssp_eval.evaluate.campaign import campaign_folder, find_labels, open_clips
from ssp_eval.evaluate.cell import CellOptions, fail_cell
from ssp_eval.evaluate.cell_file import CellResult, holds_answers
from ssp_eval.evaluate.job import Job, Settings
from ssp_eval.evaluate.labelled import LabelledClip
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.evaluate.plan import Plan, plan_of
from ssp_eval.evaluate.pool import run_pool
from ssp_eval.evaluate.ray_cluster import import_ray
from ssp_eval.evaluate.ray_engine import run_ray
from ssp_eval.labels.model import labels_version


class Engine(Protocol):
    """Does jobs in other processes; see pool.run_pool."""

    def __call__(
        self,
        jobs: Sequence[Job],
        settings: Settings,
        workers: int,
        on_dead: Callable[[Job, str], CellResult],
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
) -> list[CellResult]:
    """Evaluates every bag with every model, several cells at a time.

    Args:
        bags, models, propose_labels, admissions, on_plan, on_record: see campaign.run_campaign.
        settings: what all cells have in common.
        workers: how many processes.
        engine: one of ENGINES.

    Raises:
        InputError: a bag, its labels or an option is wrong, or a bridge is attached.
        HostError: the engine isn't installed, or a worker has another version of the software.
    """
    for model in models:
        model.read_by(settings.adapter)
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
        clips = open_clips(stack, bags, propose_labels, admissions)
        stack.enter_context(campaign_folder(settings.out))
        keep_audits(settings.out, (labelled.admission for labelled in clips))
        on_plan(plan_of(clips, models, not settings.fresh and holds_answers(settings.out)))
        jobs: list[Job] = []
        clip_of: list[LabelledClip] = []
        for labelled, (bag, labels) in zip(clips, bags, strict=True):
            path = labels or find_labels(bag)
            if path is None:
                raise InputError("has lost its labels file", file=bag)
            hashes = labelled.clip.provenance.bag_sha256, labels_version(labelled.labels)
            places, admission = (bag.absolute(), path.absolute()), labelled.admission
            for model in models:
                jobs.append(Job(len(jobs), *places, model, *hashes, admission))
                clip_of.append(labelled)

        def on_dead(job: Job, reason: str) -> CellResult:
            options = CellOptions(settings.adapter, extractor=settings.make_extractor())
            return fail_cell(clip_of[job.number], job.model, settings.out, options, reason)

        same = replace(settings, extractor_sha256=settings.make_extractor().sha256)
        return ENGINES[engine](jobs, same, workers, on_dead, on_record)
