"""A campaign over topics with a progress bar: what the command line and the node run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ssp_eval.evaluate.admission import Admission
from ssp_eval.evaluate.asker import WithAnswerers
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cell import CellOptions
from ssp_eval.evaluate.cell_file import CellResult
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.evaluate.plan import NO_CONTROLS
from ssp_eval.evaluate.show import asking
from ssp_eval.evaluate.topic_asker import CONNECT_S
from ssp_eval.evaluate.topics import TopicAskers


def evaluate_bags(
    bags: Sequence[tuple[Path, Path | None]],
    models: Sequence[ModelSpec],
    out: Path,
    options: CellOptions,
    timeout_s: float = 60.0,
    propose_labels: bool = False,
    admissions: Mapping[str, Admission] | None = None,
    start_timeout_s: float = CONNECT_S,
    no_controls: str = NO_CONTROLS,
) -> list[CellResult]:
    """Evaluates every bag with every model.

    Args:
        bags: bag and its labels file (None: look beside it).
        models: who is asked, controls included.
        out: campaign folder.
        options: adapter, reuse and repetition.
        timeout_s: for one answer.
        propose_labels: where there are no labels, propose them.
        admissions: what audits say, by hash of the bag.
        start_timeout_s: until a bridge is on its topics.
        no_controls: what leaves the controls out, for the line that tells what is asked.

    Raises:
        InputError: a bag, its labels or an option is wrong.
    """
    attached = any(model.attached for model in models)
    with (
        asking(no_controls) as (on_plan, on_record),
        TopicAskers(out / "logs", timeout_s, attached, start_timeout_s) as topics,
    ):
        return run_campaign(
            bags,
            models,
            WithAnswerers(topics),
            out,
            options,
            propose_labels,
            admissions,
            on_plan=on_plan,
            on_record=on_record,
        )
