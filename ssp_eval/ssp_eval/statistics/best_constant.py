"""The best blind constant of a scenario: the one answer that scores most when it is given always.

It looks at no frame and knows the labels, which no model does. A model that scores less than it
could have said one sentence all the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, combinations, product

from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_eval.data.labels import Labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_eval.score.aggregate import EQUAL, mean
from ssp_eval.score.engine import score_cells
from ssp_eval.score.metrics import CellMetrics
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.backends.phrases import action_points, action_sentence, scene_text
from ssp_vla_bridge.trajectory import Trajectory

# Of the trajectories: any speed within the limits of METHOD 6.6 gives the same scores.
SPEED_MPS = 8.0
_TIMES_S = (0.0, 0.5, 1.0, 1.5, 2.0)


@dataclass(frozen=True)
class Scene:
    """A text's description of the scene; None is left unsaid.

    Args:
        objects: the critical one first.
    """

    objects: tuple[str, ...] | None
    position: str | None
    motion: str | None
    conflict: str | None


@dataclass(frozen=True)
class Plan:
    """The announcement of a text and the motion of a trajectory."""

    lon_action: str
    lat_action: str

    @property
    def trajectory(self) -> Trajectory:
        """Its points, from SPEED_MPS on."""
        points = action_points(self.lon_action, self.lat_action, SPEED_MPS, _TIMES_S)
        return Trajectory(_TIMES_S, tuple(x for x, _ in points), tuple(y for _, y in points))


@dataclass(frozen=True)
class Constant:
    """An answer that is the same at every label time.

    Args:
        scene: slots of its text: objects, position, motion, conflict.
        plan: its longitudinal and lateral action, which its trajectory drives.
        scores: of each recording that it was chosen for, in their order.
    """

    scene: Scene
    plan: Plan
    scores: tuple[CellMetrics, ...]

    @property
    def text(self) -> str:
        """Return the text."""
        return _text(self.scene, self.plan)


def _text(scene: Scene, plan: Plan) -> str:
    description = scene_text(scene.objects, scene.position, scene.motion, scene.conflict)
    return f"{description} {action_sentence(plan.lon_action, plan.lat_action)}".strip()


@lru_cache(maxsize=256)
def best_constant(recordings: tuple[Labels, ...], thresholds: Thresholds = DEFAULT) -> Constant:
    """Choose the answer with the largest mean IVCS over the recordings of a scenario.

    Text and trajectory add to IVCS apart from each other, and so do the conflict and the other
    slots of the text. Each is therefore chosen by itself, by the scores of the one engine. Of equal
    ones the first in the order of the vocabularies is taken.

    - Text: each combination of a set of the classes that labels name with a position, a motion and
      a conflict that labels have. What no label has adds nothing.
    - Trajectory: each longitudinal with each lateral action of METHOD 6.6, which is all that the
      engine tells apart of feasible trajectories.

    Args:
        recordings: labels of at least one recording.
        thresholds: of the scores.
    """
    labels = list(chain.from_iterable(one.labels for one in recordings))
    positions = _words_in_labels(POSITIONS, (label.position for label in labels))
    motions = _words_in_labels(MOTIONS, (label.motion for label in labels))
    conflicts = _words_in_labels(CONFLICTS, (label.conflict for label in labels))
    plans = [Plan(lon, lat) for lon, lat in product(LON_ACTIONS, LAT_ACTIONS)]
    scenes = [
        Scene(objects, position, motion, conflicts[0])
        for objects, position, motion in product(
            _objects(label.objects for label in labels), positions, motions
        )
    ]

    scene, _ = _best(recordings, [(scene, plans[0]) for scene in scenes], thresholds)[0]
    scene, _ = _best(
        recordings,
        [(replace(scene, conflict=word), plans[0]) for word in conflicts],
        thresholds,
    )[0]
    (scene, plan), scores = _best(recordings, [(scene, plan) for plan in plans], thresholds)
    return Constant(scene, plan, scores)


def _best(
    recordings: Sequence[Labels], answers: Sequence[tuple[Scene, Plan]], thresholds: Thresholds
) -> tuple[tuple[Scene, Plan], tuple[CellMetrics, ...]]:
    """Score answers on all recordings and take the first that none exceeds by more than rounding.

    Returns:
        It, and its scores of each recording.
    """
    cells = [(one, _records(one, *answer)) for answer in answers for one in recordings]
    metrics, size = score_cells(cells, thresholds), len(recordings)
    scores = [tuple(metrics[k : k + size]) for k in range(0, len(metrics), size)]
    values = [mean(one.ivcs for one in of_answer).value or 0.0 for of_answer in scores]
    first = next(k for k, value in enumerate(values) if value >= max(values) - EQUAL)
    return answers[first], scores[first]


def _words_in_labels(vocabulary: Sequence[str], words: Iterable[str | None]) -> list[str | None]:
    """Return the words of a vocabulary that labels have, in its order; [None] if they have none."""
    label_words = set(words)
    return [word for word in vocabulary if word in label_words] or [None]


def _objects(sets: Iterable[tuple[str, ...] | None]) -> list[tuple[str, ...] | None]:
    """Return every set of the classes that labels name; the empty one where a label has it.

    A set that a label has stands in the label's order, the critical object first.
    """
    label_sets = [one for one in sets if one is not None]
    ordered = {frozenset(one): one for one in reversed(label_sets)}
    classes = [word for word in OBJECTS if any(word in one for one in label_sets)]
    object_sets: list[tuple[str, ...] | None] = [
        () for one in label_sets[:1] if frozenset() in ordered
    ]
    for size in range(1, len(classes) + 1):
        object_sets += [ordered.get(frozenset(one), one) for one in combinations(classes, size)]
    return object_sets or [None]


def _records(labels: Labels, scene: Scene, plan: Plan) -> list[BehaviourRecord]:
    """Return the answer at each label time; all of the text is evidence of each slot."""
    text = _text(scene, plan)
    whole = ((0, len(text)),)

    def slot(value: str | tuple[str, ...] | None) -> Slot | None:
        return None if value is None else Slot(value, whole)

    slots = Slots(
        slot(scene.objects),
        slot(scene.position),
        slot(scene.motion),
        slot(scene.conflict),
        slot(plan.lon_action),
        slot(plan.lat_action),
    )
    trajectory = plan.trajectory
    return [BehaviourRecord(label.t_s, text, slots, trajectory) for label in labels.labels]
