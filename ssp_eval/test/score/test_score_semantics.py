"""Slot by slot (METHOD 6.3): what a report shows beside the ratios that the golden cases check."""

import itertools

import pytest

from ssp_core.vocabulary import CONFLICTS, MOTIONS, POSITIONS
from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_eval.score.cell import SlotScore, score_cell
from ssp_eval.score.engine import hard_score, object_f1, soft_score

LABEL = Label(
    t_s=1.0,
    phase="conflict",
    risk_visible=True,
    objects=("car", "bus"),
    position="front",
    motion="oncoming",
    conflict=None,
    lon_actions=("stop",),
    lat_actions=("straight",),
)
RECORD = BehaviourRecord(
    t_s=1.0,
    text="a car",
    slots=Slots(
        objects=Slot(("car",), ((2, 5),)),
        position=Slot("front_left", ((0, 5),)),
        motion=Slot("oncoming", ((9, 12),)),
        conflict=Slot("active", ((0, 1),)),
    ),
)


def slots_of(records, first_frame_dynamics=True):
    """The slots of the one label."""
    labels = Labels("s", "physical", "v", 1.0, first_frame_dynamics, (LABEL,))
    return score_cell(labels, records).details.judgements[0].slots


def test_what_each_slot_shows():
    assert slots_of([RECORD]) == {
        "objects": SlotScore(True, True, 2 / 3, 2 / 3, ("car",), ("car", "bus")),
        "position": SlotScore(True, True, 0.0, 0.5, "front_left", "front"),
        "motion": SlotScore(True, False, 0.0, 0.0, None, "oncoming"),
        "conflict": SlotScore(False, True, None, None, "active", None),
    }


def test_a_masked_slot_keeps_its_values_but_has_no_score():
    slots = slots_of([RECORD], first_frame_dynamics=False)
    assert slots["motion"] == SlotScore(False, False, None, None, None, "oncoming")
    assert slots["conflict"].h is None
    assert slots["position"].evaluable


def test_without_a_record_every_evaluable_slot_scores_zero():
    slots = slots_of([])
    assert [slot.evaluable for slot in slots.values()] == [True, True, True, False]
    assert [(slot.given, slot.h, slot.s) for slot in slots.values()] == [
        (False, 0.0, 0.0),
        (False, 0.0, 0.0),
        (False, 0.0, 0.0),
        (False, None, None),
    ]


@pytest.mark.parametrize(("vocabulary", "adjacent"), [(POSITIONS, 8), (CONFLICTS, 4), (MOTIONS, 0)])
def test_adjacency_is_symmetric_and_as_large_as_the_method_says(vocabulary, adjacent):
    pairs = list(itertools.permutations(vocabulary, 2))
    assert sum(soft_score(a, b, 0.5) == 0.5 for a, b in pairs) == adjacent
    assert all(soft_score(a, b, 0.5) == soft_score(b, a, 0.5) for a, b in pairs)
    assert all(soft_score(a, a, 0.5) == 1.0 for a in vocabulary)


def test_f1_of_sets():
    assert object_f1([], []) == 1.0
    assert object_f1(["car"], []) == 0.0
    assert object_f1(["car", "car"], ["car"]) == 1.0
    assert object_f1(["car", "bus"], ["car", "truck", "bus", "cyclist"]) == 2 / 3


def test_a_word_is_never_a_set():
    assert hard_score("car", ("car",)) == hard_score(("car",), "car") == 0.0
