"""Words as codes, tables by code, and the composite: the small parts of scoring many cells."""

import numpy as np
import pytest

from ssp_core.vocabulary import CONFLICTS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_eval.score.cell import score_cell
from ssp_eval.score.columns import NOTHING, Codes
from ssp_eval.score.engine import allowed, risky, score_cells, score_tables, slows_down
from ssp_eval.score.metrics import ivcs, ivcs_terms
from ssp_eval.score.thresholds import DEFAULT, Thresholds


def test_words_are_numbered_in_the_order_of_their_vocabulary():
    codes = Codes(POSITIONS, bits=False)
    assert [codes[word] for word in POSITIONS] == list(range(8))
    assert codes[None] == codes[""] == NOTHING == -1


def test_sets_are_the_bits_of_their_words():
    codes = Codes(OBJECTS, bits=True)
    assert [codes[(word,)] for word in OBJECTS] == [1, 2, 4, 8, 16, 32]
    assert codes[()] == 0
    assert codes[("bus", "car")] == codes[("car", "bus", "car")] == 5
    assert codes[OBJECTS] == 63


@pytest.mark.parametrize("bits", [False, True])
@pytest.mark.parametrize("value", ["tram", ("tram",), ("car",), ("car", "tram"), "car"])
def test_what_no_vocabulary_holds_is_refused(value, bits):
    if value == ("car" if not bits else ("car",)):
        assert Codes(OBJECTS, bits)[value] == (0 if not bits else 1)
        return
    with pytest.raises(ValueError, match="of the vocabulary car, truck, bus, motorcycle, cyclist"):
        Codes(OBJECTS, bits)[value]


def test_tables_hold_every_answer_and_truth():
    tables = score_tables(0.25)
    sizes = [64, len(POSITIONS), len(MOTIONS), len(CONFLICTS)]
    assert [hard.shape for hard, _ in tables] == [(size + 1, size) for size in sizes]
    assert [soft.shape for _, soft in tables] == [(size + 1, size) for size in sizes]
    for hard, soft in tables:
        assert not hard[NOTHING].any()
        assert not soft[NOTHING].any()
        assert (hard.diagonal() == 1).all()
        assert (soft >= hard).all()
    objects, positions, motions, conflicts = tables
    # {car, bus} against {bus, cyclist}: 2 * 1 / 4; an empty answer against one that isn't: 0.
    assert objects[0][0b101, 0b10100] == objects[1][0b101, 0b10100] == 0.5
    assert objects[0][0, 0b101] == objects[0][0b101, 0] == 0
    # {car} against {car, truck, bus}: 2 * 1 / 4.
    assert objects[0][0b1, 0b111] == 0.5
    for (hard, soft), pairs in ((positions, 8), (motions, 0), (conflicts, 4)):
        np.testing.assert_array_equal(hard[:-1], np.eye(hard.shape[1]))
        assert (soft[:-1] == 0.25).sum() == pairs
    front, front_left = POSITIONS.index("front"), POSITIONS.index("front_left")
    assert positions[1][front, front_left] == 0.25


def test_what_is_allowed():
    stop, decelerate, maintain, accelerate = range(len(LON_ACTIONS))
    actions = np.array([stop, decelerate, maintain, accelerate, NOTHING, NOTHING])
    bits = np.array([0b0001, 0b0101, 0b0100, 0b0111, 0b1111, 0])
    assert allowed(actions, bits).tolist() == [True, False, True, False, False, False]


def test_which_conflicts_and_actions_count_for_the_response():
    every = np.array([*range(4), NOTHING])
    assert risky(every).tolist() == [False, True, True, False, False]
    assert slows_down(every).tolist() == [True, True, False, False, False]


def test_the_composite_is_linear_in_its_components():
    """METHOD 6.10: IVCS of a mixture is the mixture of the IVCS; weights are what 1 alone adds."""
    names = ("jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr")
    weights = (0.10, 0.30, 0.20, 0.30, 0.10)
    zero = dict.fromkeys(names, 0.0)
    for name, weight in zip(names, weights, strict=True):
        assert ivcs(zero | {name: 1.0}) == weight
        assert ivcs_terms(zero | {name: 0.5})[name] == weight / 2
    assert ivcs(dict.fromkeys(names, 1.0)) == 1.0
    some = dict(zip(names, (0.25, 0.5, 0.75, 1.0, 0.0), strict=True))
    other = dict(zip(names, (1.0, 0.125, 0.0, 0.5, 1.0), strict=True))
    mixed = {name: 0.75 * some[name] + 0.25 * other[name] for name in names}
    assert ivcs(mixed) == pytest.approx(0.75 * ivcs(some) + 0.25 * ivcs(other), abs=1e-15)


def test_a_null_component_adds_nothing():
    components = {"jovr": 1.0, "sem_acc_eff": None, "cia_eff": None, "tqsr": 0.5, "rsr": 1}
    assert ivcs_terms(components) == {
        "jovr": 0.1,
        "sem_acc_eff": 0.0,
        "cia_eff": 0.0,
        "tqsr": 0.15,
        "rsr": 0.1,
    }
    assert ivcs(components, DEFAULT) == pytest.approx(0.35, abs=1e-15)


def test_other_weights_can_be_asked_for():
    components = dict.fromkeys(("jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr"), 1.0)
    assert ivcs(components, Thresholds(weight_rsr=0.6)) == pytest.approx(1.5, abs=1e-15)


def test_evidence_beyond_any_text_supports_nothing():
    """Places that don't fit into 64 bits are as far outside as any (METHOD 5.3)."""
    label = Label(1.0, "conflict", True, ("car",), *[None] * 3, ("stop",), ("straight",))
    labels = Labels("s", "physical", "v", 1.0, True, (label,))
    far = 10**30
    for evidence, given in (
        (((0, far),), 0),
        (((-far, 3),), 0),
        (((0, far), (0, 3)), 1),
        (((-far, far), (far, far + 1)), 0),
    ):
        record = BehaviourRecord(1.0, "car", Slots(objects=Slot(("car",), evidence)))
        assert [score.sem_cov for score in score_cells([(labels, [record])])] == [given]
        assert score_cell(labels, [record]).sem_cov == given
