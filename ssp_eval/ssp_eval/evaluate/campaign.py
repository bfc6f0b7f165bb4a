"""Campaigns: bags × models → cells. An interrupted campaign goes on where it stopped."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder, taken_folder
from ssp_core.hashing import sha256_file
from ssp_eval.data.labels import Labels, compare_by_scenario, load_labels
from ssp_eval.data.provenance import SAFE_NAME, bag_folder, beside_bag, find_labels
from ssp_eval.evaluate.cell import evaluate_again
from ssp_eval.evaluate.clients.model_client import ModelClients
from ssp_eval.evaluate.clients.models import BLIND, CONDITIONS, REASONING, REPEAT, TWIN, ModelSpec
from ssp_eval.evaluate.conditions.design import series_of
from ssp_eval.evaluate.conditions.expansion import with_repeats, with_twin_conditions
from ssp_eval.evaluate.conditions.twin_clips import with_twins
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import NO_AUDIT, Admission, keep_audits
from ssp_eval.evaluate.store.cell_file import CellResult, LabelledClip, holds_answers
from ssp_eval.labels.check import plan_problems
from ssp_eval.labels.propose import propose_by_plan
from ssp_eval.labels.review import is_unreviewed, write_proposal
from ssp_eval.labels.truth import Truth, truth_from_bag
from ssp_eval.observations.files import find_observations
from ssp_eval.recordings.clip import Clip
from ssp_eval.score.thresholds import DEFAULT
from ssp_vla_bridge.window import Preprocessing

NO_CONTROLS = "--no-controls"


@dataclass(frozen=True)
class Plan:
    """The number of questions of a campaign; those whose answers are stored are counted too.

    Args:
        label_times: of all cells, also of those that are refused and not asked.
        to_answerers: of these, to the harness's own answerers.
        spoilt: of these, to models that are asked once more with spoilt frames.
        corrupted: of these, to models that are asked once more with corrupted pictures.
        given_back: of these, to models that are given their own text back.
        blind: of these, to models that are shown no picture.
        about_twins: of these, to models that are asked about twins in the place of recordings.
        repeated: of these, the factual ones that are asked again after all others.
        goes_on: some may have an answer that is stored, and isn't asked for again.
        label_lines: per scenario how many labels each phase has, and whether the domains compare
            (METHOD 5.2b).
    """

    label_times: int
    cells: int
    questions: int
    to_answerers: int
    spoilt: int
    corrupted: int = 0
    about_twins: int = 0
    given_back: int = 0
    blind: int = 0
    repeated: int = 0
    goes_on: bool = False
    label_lines: tuple[str, ...] = field(default=(), compare=False)

    def line(self, leave_out: str = NO_CONTROLS) -> str:
        """Return the plan for people."""
        text = f"{_count(self.cells, 'cell')}, {_count(self.questions, 'question')}"
        if self.goes_on:
            text += " (those with a stored answer are counted and not asked again)"
        controls = self.to_answerers + self.spoilt
        parts = []
        if self.spoilt:
            parts.append(f"{self.spoilt} repeat the models' questions with spoilt frames")
        if self.to_answerers:
            parts.append(f"{self.to_answerers} go to the built-in answerers")
        details = []
        if controls:
            what = ", ".join(parts)
            details.append(f"{controls} for controls: {what} ({leave_out} leaves them out)")
        if self.corrupted:
            details.append(f"{self.corrupted} repeat the models' questions with corrupted pictures")
        if self.about_twins:
            details.append(f"{self.about_twins} once more about twins")
        if self.given_back:
            details.append(f"{self.given_back} with the model's own text given back")
        if self.blind:
            details.append(f"{self.blind} without pictures")
        if self.repeated:
            details.append(f"{self.repeated} as before, to see what changes without a cause")
        return f"{text}; of these {'; '.join(details)}" if details else text


def plan_of(
    clips: Sequence[LabelledClip], models: Sequence[ModelSpec], goes_on: bool = False
) -> Plan:
    """Plan the questions of a campaign.

    Args:
        clips: the campaign's recordings with their labels.
        models: as the campaign asks them.
        goes_on: the campaign has answers already, and they count.
    """
    compared = compare_by_scenario(
        (clip.labels.scenario, clip.labels.domain, clip.labels) for clip in clips
    )
    counts = Counter[str]()
    for clip in clips:
        each = len(clip.labels.labels)
        for model in models_of(clip, models):
            counts["label_times"] += each
            if clip.refusal is not None:
                continue
            counts["cells"] += 1
            counts["questions"] += each
            counts[_purpose(model)] += each
    return Plan(
        label_times=counts["label_times"],
        cells=counts["cells"],
        questions=counts["questions"],
        to_answerers=counts["answerers"],
        spoilt=counts["spoilt"],
        corrupted=counts["corrupted"],
        about_twins=counts["twins"],
        given_back=counts["given back"],
        blind=counts[BLIND],
        repeated=counts["repeated"],
        goes_on=goes_on,
        label_lines=tuple(f"{name}: {comparison.line}" for name, comparison in compared.items()),
    )


def _purpose(model: ModelSpec) -> str:
    """Describe the purpose of asking a model, in the words of plan_of."""
    if model.condition.startswith(TWIN):
        return "twins"
    if model.condition.startswith(REASONING):
        return "given back"
    if model.condition == BLIND:
        return BLIND
    if model.condition == REPEAT:
        return "repeated"
    if model.condition:
        return "spoilt" if model.condition in CONDITIONS else "corrupted"
    return "answerers" if model.answerer else "models"


def models_of(labelled: LabelledClip, models: Sequence[ModelSpec]) -> list[ModelSpec]:
    """List the models to ask about a recording: as such, under its twins, and repeated."""
    return with_repeats(with_twin_conditions(models, list(labelled.twins)))


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def labelled_clip(
    clip: Clip,
    labels_path: Path | None,
    admission: Admission = NO_AUDIT,
) -> LabelledClip:
    """Return a clip with the labels that belong to it.

    Raises:
        InputError: there are none, they belong to another clip, or contradict their plan.
    """
    path = labels_path or find_labels(clip.path)
    if path is not None:
        labels = load_labels(path)
        _check_name(labels, path)
        _check_plan(labels, path)
        _check_belongs(clip, labels, path)
        labelled = _labelled(clip, labels, path.name, is_unreviewed(path), admission)
        if labelled.refusal is None:
            _check_span(clip, labels, path)
        return labelled
    raise InputError(
        "has no labels file inside or beside it",
        file=clip.path,
        remedy="give --labels FILE, or --propose-labels to make them from the recorded states",
    )


def _propose(clips: Sequence[Clip]) -> None:
    """Propose labels beside bags, those of a scenario by one plan (METHOD 5.2b).

    Raises:
        InputError: a recording has no states or no event.
    """
    scenarios: dict[tuple[str, str], list[tuple[Clip, Truth]]] = {}
    for clip in clips:
        truth = truth_from_bag(clip.path)
        key = truth.scenario, truth.event_version
        scenarios.setdefault(key, []).append((clip, truth))
    for group in scenarios.values():
        proposals, problem = propose_by_plan([truth for _, truth in group])
        if problem:
            console.note(f"note: {problem}: labels on a grid on the clock")
        for (clip, _), proposal in zip(group, proposals, strict=True):
            _check_name(proposal.labels, clip.path)
            target = beside_bag(bag_folder(clip.path))
            make_folder(target.parent)
            write_proposal(target, proposal, source=clip.provenance.bag_sha256)


def _labelled(
    clip: Clip, labels: Labels, source: str, proposed: bool, admission: Admission
) -> LabelledClip:
    admission.check_is_of(clip.provenance)
    observed = {file.name: sha256_file(file) for file in find_observations(clip.path)}
    bag_admission = admission.confirm(clip.provenance.verdict_sha256, observed)
    clip.crop_to(bag_admission.crop)
    return LabelledClip(clip, labels, source, proposed, bag_admission)


def _check_plan(labels: Labels, file: Path) -> None:
    """Refuse labels whose phases, places or times aren't those of their plan (METHOD 5.2b)."""
    for problem in plan_problems(labels):
        field, _, what = problem.partition(": ")
        raise InputError(
            f"contradicts the plan: {what}",
            file=file,
            field=field,
            remedy="`ssp labels check` lists all such labels; `ssp labels new` plans anew",
        )


def _check_name(labels: Labels, file: Path) -> None:
    """Refuse a scenario that is no part of a folder's name, such as one that leads out of it."""
    if not re.fullmatch(SAFE_NAME, labels.scenario):
        raise InputError(
            "is no name that a cell's folder can have",
            file=file,
            field="scenario",
            value=labels.scenario,
            remedy="use letters, digits, _ - and ., a letter or digit first, 64 at most",
        )


def _check_belongs(clip: Clip, labels: Labels, path: Path) -> None:
    facts = clip.provenance
    for name, ours, theirs in (
        ("scenario", labels.scenario, facts.scenario),
        ("domain", labels.domain, facts.domain),
    ):
        if theirs is not None and ours != theirs:
            raise InputError(
                f"is for {ours!r}, but the bag {clip.path} is {theirs!r}",
                file=path,
                field=name,
                remedy="give the bag's own labels with --labels",
            )


def _check_span(clip: Clip, labels: Labels, path: Path) -> None:
    """Refuse labels at times of which the clip has no frame (METHOD 6.1 for how near one is)."""
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
    """Refuse two clips of one scenario and domain: they would be one cell.

    Raises:
        InputError: naming both bags.
    """
    paths: dict[str, Path] = {}
    for labelled in clips:
        other = paths.setdefault(labelled.name, labelled.clip.path)
        if other != labelled.clip.path:
            raise InputError(
                f"is {labelled.name.replace('__', ' in ')}, and so is {other}",
                file=labelled.clip.path,
                remedy="evaluate repetitions into different --out folders",
            )


def _check_once(clip: Clip, others: Sequence[Clip]) -> None:
    """Refuse a recording that is given twice, be it under two paths.

    Raises:
        InputError: naming both.
    """
    digest = clip.provenance.bag_sha256
    for other in others:
        if other.provenance.bag_sha256 == digest:
            raise InputError(
                f"is the same recording as {other.path}",
                file=clip.path,
                value=digest,
                remedy="give each bag once",
            )


def _prepare(clip: Clip, labels_file: Path | None, rules: Preprocessing) -> None:
    """Fetch the first questions as long as the bag is being hashed; none is asked yet.

    What is wrong with labels or frames is said in its turn.
    """
    with suppress(InputError):
        path = labels_file or find_labels(clip.path)
        for label in () if path is None else load_labels(path).labels:
            if clip.is_hashed:
                return
            clip.question(label.t_s, rules)


def open_clips(
    stack: ExitStack,
    bags: Sequence[tuple[Path, Path | None]],
    propose_labels: bool = False,
    admissions: Mapping[str, Admission] | None = None,
    rules: Preprocessing | None = None,
    twins: bool = False,
) -> list[LabelledClip]:
    """Return the clips of a campaign with their labels, checked all together.

    Args:
        stack: closes the clips.
        bags: bag and its labels file (None: look beside it).
        propose_labels: propose labels for each bag that has none.
        admissions: what audits say, by hash of the bag; a bag that isn't there is unaudited.
        rules: of what is asked first; the time that hashing takes is used for it.
        twins: open those beside the recordings as well.

    Raises:
        InputError: a bag or its labels are wrong.
    """
    opened: list[Clip] = []
    for bag, labels in bags:
        clip = stack.enter_context(Clip(bag))
        if not opened and rules is not None:
            _prepare(clip, labels, rules)
        # One bag after the other is hashed, however many there are.
        _check_once(clip, opened)
        opened.append(clip)
    if propose_labels:
        pairs = zip(opened, bags, strict=True)
        _propose([c for c, (_, labels) in pairs if labels is None and find_labels(c.path) is None])
    clips = []
    for clip, (_, labels) in zip(opened, bags, strict=True):
        admission = (admissions or {}).get(clip.provenance.bag_sha256, NO_AUDIT)
        clips.append(labelled_clip(clip, labels, admission))
    check_distinct(clips)
    return _with_all_twins(stack, clips) if twins else clips


def _with_all_twins(stack: ExitStack, clips: Sequence[LabelledClip]) -> list[LabelledClip]:
    """Return the clips with the twins beside them.

    Raises:
        InputError: none has any, or they are of other recordings.
    """
    clips_and_twins = [with_twins(stack, labelled) for labelled in clips]
    without = [str(labelled.clip.path) for labelled in clips_and_twins if not labelled.twins]
    if len(without) == len(clips_and_twins):
        raise InputError(
            "there are no twins beside the recordings that could be asked about",
            field="--twins",
            value=", ".join(without),
            remedy="make them with `ssp twins RUN --change WHAT`",
        )
    for path in without:
        console.note(f"note: {path} has no twins beside it")
    return clips_and_twins


def run_campaign(
    bags: Sequence[tuple[Path, Path | None]],
    models: Sequence[ModelSpec],
    clients: ModelClients,
    out: Path,
    options: CellOptions,
    propose_labels: bool = False,
    admissions: Mapping[str, Admission] | None = None,
    on_plan: Callable[[Plan], None] = lambda _: None,
    on_record: Callable[[], None] = lambda: None,
    twins: bool = False,
) -> list[CellResult]:
    """Evaluate every bag with every model.

    Args:
        bags: bag and its labels file (None: look beside it).
        models: as they are asked, conditions included.
        clients: give the way to each model.
        out: campaign folder; it is locked meanwhile.
        options: of all cells.
        propose_labels: propose labels for each bag that has none.
        admissions: what audits say, by hash of the bag; a bag that isn't there is unaudited.
        on_plan: called once with how much there is to ask, before anything is asked.
        on_record: called after each label time of a cell.
        twins: ask about the twins beside the recordings as well.

    Raises:
        InputError: a bag, its labels or an option is wrong; nothing was asked then.
    """
    for model in models:
        model.read_by(options.adapter)
    results = []
    with ExitStack() as stack:
        rules = models[0].rules if models else None
        clips = open_clips(stack, bags, propose_labels, admissions, rules, twins)
        stack.enter_context(taken_folder(out))
        keep_audits(out, (labelled.admission for labelled in clips))
        on_plan(plan_of(clips, models, not options.fresh and holds_answers(out)))
        for labelled in clips:
            for series in series_of(models_of(labelled, models)):
                results += evaluate_again(labelled, series, clients, out, options, on_record)
                for model in series:
                    labelled.forget_twin(model)
            labelled.clip.forget_questions()
    return results
