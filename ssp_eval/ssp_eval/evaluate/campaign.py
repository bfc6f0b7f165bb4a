"""Campaigns: bags × models → cells. An interrupted campaign goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import make_folder
from ssp_eval.evaluate.asker import Askers, ModelSpec
from ssp_eval.evaluate.cell import CellOptions, CellResult, LabelledClip, evaluate_cell
from ssp_eval.evaluate.clip import Clip
from ssp_eval.evaluate.truth import truth_from_bag
from ssp_eval.labels.model import Labels, load_labels
from ssp_eval.labels.proposal_file import is_unreviewed, write_proposal
from ssp_eval.labels.propose import propose
from ssp_eval.score import DEFAULT
from ssp_vla_bridge.core.adapters import check_adapter


def find_labels(bag: Path) -> Path | None:
    """The labels file of a bag: inside it, beside it as ``<bag>.labels.json``, or in its folder."""
    candidates = (
        bag / "labels.json",
        bag.parent / f"{bag.name}.labels.json",
        bag.parent / "labels.json",
    )
    return next((path for path in candidates if path.is_file()), None)


def labelled_clip(clip: Clip, labels_path: Path | None, propose_labels: bool) -> LabelledClip:
    """A clip with the labels that belong to it.

    Args:
        clip: open.
        labels_path: given by the user; None looks beside the bag.
        propose_labels: where there are none, propose them from the recorded ground truth.

    Raises:
        InputError: there are none, or they belong to another clip.
    """
    path = labels_path or find_labels(clip.path)
    if path is not None:
        labels = load_labels(path)
        _check_belongs(clip, labels, path)
        labelled = LabelledClip(clip, labels, path.name, is_unreviewed(path))
        if labelled.refusal is None:
            _check_span(clip, labels, path)
        return labelled
    facts = clip.provenance
    if not propose_labels:
        raise InputError(
            "has no labels file inside or beside it",
            file=clip.path,
            remedy="give --labels FILE, or --propose-labels to make them from the ground truth",
        )
    proposal = propose(truth_from_bag(clip.path))
    target = clip.path.parent / f"{clip.path.name}.labels.json"
    make_folder(target.parent)
    write_proposal(target, proposal, source=facts.bag_sha256)
    return LabelledClip(clip, proposal.labels, target.name, True)


def _check_belongs(clip: Clip, labels: Labels, path: Path) -> None:
    facts = clip.provenance
    for field, ours, theirs in (
        ("scenario", labels.scenario, facts.scenario),
        ("domain", labels.domain, facts.domain),
    ):
        if theirs is not None and ours != theirs:
            raise InputError(
                f"is for {ours!r}, but the bag {clip.path} is {theirs!r}",
                file=path,
                field=field,
                remedy="give the bag's own labels with --labels",
            )


def _check_span(clip: Clip, labels: Labels, path: Path) -> None:
    """Refuses labels at times of which the clip has no frame (METHOD 6.1 for how near one is)."""
    for index, label in enumerate(labels.labels):
        if not (
            DEFAULT.at_least(label.t_s, clip.first_s)
            and DEFAULT.at_most(label.t_s - clip.last_s, DEFAULT.match_window_s)
        ):
            raise InputError(
                "lies outside the clip",
                file=path,
                field=f"labels[{index}].t_s",
                value=label.t_s,
                remedy=f"the frames of {clip.path} span {clip.first_s:.3f} to {clip.last_s:.3f} s",
            )


def check_distinct(clips: Sequence[LabelledClip]) -> None:
    """Refuses two clips of one scenario and domain: they would be one cell.

    Raises:
        InputError: naming both bags.
    """
    seen: dict[str, Path] = {}
    for labelled in clips:
        other = seen.setdefault(labelled.name, labelled.clip.path)
        if other != labelled.clip.path:
            raise InputError(
                f"is {labelled.name.replace('__', ' in ')}, and so is {other}",
                file=labelled.clip.path,
                remedy="evaluate repetitions into different --out folders",
            )


def run_campaign(
    bags: Sequence[tuple[Path, Path | None]],
    models: Sequence[ModelSpec],
    askers: Askers,
    out: Path,
    options: CellOptions,
    propose_labels: bool = False,
    on_total: Callable[[int], None] = lambda _: None,
    on_record: Callable[[], None] = lambda: None,
) -> list[CellResult]:
    """Evaluates every bag with every model.

    Args:
        bags: bag and its labels file (None: look beside it).
        models: who is asked.
        askers: the way to them.
        out: campaign folder.
        options: adapter and reuse.
        propose_labels: where there are no labels, propose them.
        on_total: told once how many label times there are.
        on_record: called once per label time and model.

    Raises:
        InputError: a bag, its labels or an option is wrong; nothing was asked then.
    """
    check_adapter(options.adapter)
    results = []
    with ExitStack() as stack:
        clips = [
            labelled_clip(stack.enter_context(Clip(bag)), labels, propose_labels)
            for bag, labels in bags
        ]
        check_distinct(clips)
        make_folder(out)
        on_total(sum(len(c.labels.labels) for c in clips) * len(models))
        for labelled in clips:
            for model in models:
                result = evaluate_cell(labelled, model, askers, out, options, on_record)
                results.append(result)
    return results
