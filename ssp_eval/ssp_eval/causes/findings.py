"""The cause that moved a model's answers, in words, and the limits of its answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

from ssp_eval.causes.answers import (
    PICTURES,
    REASONING,
    TWIN,
    CellAnswers,
    answers_of_cell,
    comparable_cells,
)
from ssp_eval.causes.effects import (
    TRAJECTORY,
    Effect,
    Verdict,
    effects_of,
    largest,
)
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.statistics.table import counted, some
from ssp_eval.twins.changes import Kind

# A turned text that moves the trajectory by less than this share of what the object does isn't the
# reason of it.
MINOR = 0.25
# An irrelevant change that alters so many answers leaves nothing that could be attributed.
UNSTEADY = 0.5


class Word(Enum):
    """The origin of a model's answers, as far as it is known."""

    OBJECT = "uses the object"
    EXPLAINS_LATER = "decides first, explains later"
    HISTORY = "copies its history"
    PICTURES = "uses the pictures, not the object"
    IGNORES = "ignores the object"
    UNSTEADY = "moved by anything"
    OPEN = "undetermined"


@dataclass(frozen=True)
class Finding:
    """The finding about one model.

    Args:
        tested: False: it rests on recordings too few for any test.
        sentences: the evidence, and what can't be concluded.
    """

    model: str
    word: Word
    tested: bool
    sentences: tuple[str, ...]

    @property
    def text(self) -> str:
        """All of it."""
        return " ".join(self.sentences)


_MOVED = frozenset({Verdict.MOVED, Verdict.UNTESTED})
_LACKS = {
    Verdict.UNCONTROLLED: "without a control",
    Verdict.UNREPEATED: "and the factual question wasn't asked again",
}
_SAID = frozenset({*Verdict} - {Verdict.NOT_GIVEN})


@dataclass(frozen=True)
class MovedAnswers:
    """All that a report says of what moved the answers."""

    cells: tuple[CellAnswers, ...]
    effects: tuple[Effect, ...]
    findings: tuple[Finding, ...]


def moved_by(cells: Iterable[CellData]) -> MovedAnswers | None:
    """Find the causes that moved the answers in these cells; None where no cause was changed.

    Args:
        cells: with their records, in any order; of several campaigns too.
    """
    return compared(answers_in(cells))


def answers_in(cells: Iterable[CellData]) -> list[CellAnswers]:
    """Collect the answers of the cells that are compared."""
    listed = [*cells]
    cell_ids = comparable_cells(cell.id for cell in listed)
    return [
        answers for cell in listed if cell.id in cell_ids and (answers := answers_of_cell(cell))
    ]


def compared(answers: Iterable[CellAnswers]) -> MovedAnswers | None:
    """Find the causes as moved_by does, from collected answers."""
    cells = tuple(answers)
    by_model: dict[str, list[Effect]] = {}
    for effect in effects_of(cells):
        by_model.setdefault(effect.model, []).append(effect)
    if not by_model:
        return None
    return MovedAnswers(
        cells,
        tuple(effect for of in by_model.values() for effect in of),
        tuple(finding(model, of) for model, of in by_model.items()),
    )


def finding(model: str, effects: Sequence[Effect]) -> Finding:
    """Return the finding of one model.

    What distinguishes one from the others stands in ``docs/twins.md``.

    Args:
        model: its name.
        effects: of all causes.
    """
    of_object = [e for e in effects if e.cause.of_object]
    of_history = [e for e in effects if e.cause.family == TWIN and e.cause.kind == Kind.HISTORY]
    of_pictures = [
        e
        for e in effects
        if e.cause.family == PICTURES or (e.cause.family, e.cause.kind) == (TWIN, Kind.CAMERA)
    ]
    by_text = [e for e in effects if e.cause.family == REASONING and e.output == TRAJECTORY]
    groups = [
        ("the object", of_object),
        ("its own history", of_history),
        ("the pictures", of_pictures),
    ]
    sentences = [text for name, group in groups if (text := _sentence(name, group))]
    noise = _noise(effects)
    word, why = _word(of_object, of_history, of_pictures, by_text, noise)
    if any(_is(e, Verdict.UNTESTED) for e in effects):
        n = max(e.recordings for e in effects)
        sentences.append(
            f"{counted(n, 'recording')} can't support a test: the differences were seen in these, "
            "where the control and the repeated question changed nothing; others may differ."
        )
    tested = _is_tested(effects)
    return Finding(model, word, tested, (*sentences, *why))


def _is_tested(effects: Iterable[Effect]) -> bool:
    """Tell whether there are as many recordings as a test needs."""
    return any(_is(e, Verdict.MOVED) or e.decidable for e in effects)


def _is(effect: Effect, verdict: Verdict) -> bool:
    return effect.verdict is verdict


def _moved(effects: Iterable[Effect]) -> list[Effect]:
    return [e for e in effects if e.verdict in _MOVED]


def _unmoved(effects: Iterable[Effect]) -> bool:
    """Tell whether something is given and no part of it moved by as much as could be shown."""
    answered_effects = [e for e in effects if e.verdict in _SAID]
    return bool(answered_effects) and all(e.verdict is Verdict.NONE for e in answered_effects)


def _is_minor(by_text: Sequence[Effect], of_object: Sequence[Effect]) -> bool:
    """Tell whether, by its interval, turned text moves the trajectory far less than the object."""
    most = max((e.size or 0.0 for e in _moved(_of(of_object, True))), default=0.0)
    highs = [e.interval.high for e in by_text if e.verdict in _SAID]
    return bool(highs) and all(high is not None and high <= MINOR * most for high in highs)


def _of(effects: Iterable[Effect], is_trajectory: bool) -> list[Effect]:
    return [e for e in effects if (e.output == TRAJECTORY) == is_trajectory]


def _noise(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Say why recordings too few for a test show nothing of a model; empty where they do."""
    tried = [e for e in effects if e.cause.family == TWIN]
    if _is_tested(effects) or not tried or all(e.quiet for e in tried):
        return ()
    few = f"{counted(max(e.recordings for e in tried), 'recording')} can't show anything"
    if any(e.changed_by_repeat is None for e in tried):
        return (f"{few}: the factual question wasn't asked again at the end.",)
    if not any(e.control for e in tried):
        return (f"{few}: there is no control.",)
    return (f"{few}: the control, or the same question asked again, changes these answers too.",)


def _word(
    of_object: Sequence[Effect],
    of_history: Sequence[Effect],
    of_pictures: Sequence[Effect],
    by_text: Sequence[Effect],
    noise: tuple[str, ...],
) -> tuple[Word, tuple[str, ...]]:
    if _moved(of_object):
        return _by_the_object(of_object, by_text)
    if _moved(of_history):
        return Word.HISTORY, ()
    if not of_object:
        return Word.OPEN, ("No twin with a changed object was asked about.",)
    if noise:
        return Word.OPEN, noise
    if _is_unsteady(of_object):
        return Word.UNSTEADY, (
            "The irrelevant change, or the same question asked again, alters these answers as "
            "well: no effect can be attributed to the object.",
        )
    if not _unmoved(of_object):
        text = "An effect of the object is neither shown nor excluded: it needs more recordings."
        return Word.OPEN, (text,)
    if _moved(of_pictures):
        return Word.PICTURES, ()
    text = "Its answers may come from habit, or from something that no twin changed."
    return Word.IGNORES, (text,)


def _is_unsteady(effects: Iterable[Effect]) -> bool:
    return any(
        max(e.changed_by_control or 0.0, e.changed_by_repeat or 0.0) >= UNSTEADY
        for e in effects
        if e.output != TRAJECTORY and e.coverage and e.control
    )


def _by_the_object(
    of_object: Sequence[Effect], by_text: Sequence[Effect]
) -> tuple[Word, tuple[str, ...]]:
    """Return the word for a model moved by the object, by whether its text is the reason."""
    if _moved(by_text):
        text = (
            "Its own text with one fact turned moves its trajectory: the text is a reason for it."
        )
        return Word.OBJECT, (text,)
    if _unmoved(by_text) or _is_minor(by_text, of_object):
        return Word.EXPLAINS_LATER, (
            "Its own text with one fact turned doesn't move its trajectory: the text isn't the "
            "reason for it.",
        )
    text_part, path_part = _of(of_object, False), _of(of_object, True)
    for moved, other, first, second in (
        (text_part, path_part, "text", "trajectory"),
        (path_part, text_part, "trajectory", "text"),
    ):
        if _moved(moved) and _unmoved(other):
            return Word.EXPLAINS_LATER, (
                f"The object moves its {first} and not its {second}: the text isn't the reason "
                "for the trajectory.",
            )
    return Word.OBJECT, (
        "Whether its text is the reason for its trajectory is unknown: its own text wasn't, "
        "or couldn't be, given back with one fact turned.",
    )


def _sentence(name: str, group: Sequence[Effect]) -> str:
    """Say what a group of causes moved; empty where none of it was asked."""
    answered_effects = [e for e in group if e.verdict in _SAID]
    if not answered_effects:
        return ""
    moved = _moved(answered_effects)
    if not moved:
        if _unmoved(answered_effects):
            return f"Not moved by {name}."
        for verdict, lacks in _LACKS.items():
            bare = dict.fromkeys(e.cause.words for e in answered_effects if _is(e, verdict))
            if bare:
                return f"Differs with a change of {name} ({some([*bare])}), {lacks}."
        return f"An effect of {name} is not shown."
    parts = []
    for is_trajectory in (True, False):
        clearest = largest(_of(moved, is_trajectory))
        if clearest is not None:
            parts.append(_clause(clearest))
    causes = dict.fromkeys(e.cause.words for e in moved)
    return f"Moved by {name} ({some([*causes])}): {'; '.join(parts)}."


def _clause(effect: Effect) -> str:
    low, high = effect.interval.low, effect.interval.high
    size = effect.size or 0.0
    show: Callable[[float], str] = (
        "{:.2f} m".format if effect.output == TRAJECTORY else "{:.0%}".format
    )
    is_tested = effect.verdict is Verdict.MOVED and low is not None and high is not None
    span = f" [{show(low or 0.0)}, {show(high or 0.0)}]" if is_tested else ""
    name = effect.output.replace("_", " ")
    where = "more of the label times" if effect.output != TRAJECTORY else "further"
    p = "untested" if effect.verdict is Verdict.UNTESTED else f"Holm p {effect.p_holm:.2g}"
    noise = "with the repeated question" if effect.above_repeat else "with the control"
    return f"{name} {show(size)}{span} {where} than {noise} ({effect.cause.words}, {p})"
