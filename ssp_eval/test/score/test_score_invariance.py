"""Changes that must not move a score, and changes that may only raise it (METHOD 6)."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from score_inputs import MOVES, SHIFTS, any_labels, any_records

from ssp_eval.data.records import Slot
from ssp_eval.score.cell import score_cell
from ssp_eval.score.engine import score_cells
from ssp_vla_bridge.trajectory import Trajectory

RATIOS = (
    "jovr",
    "sem_cov",
    "sem_acc_cond",
    "sem_acc_eff",
    "sem_acc_soft",
    "cia_eff",
    "act_acc_eff",
    "stfr",
    "tqsr",
    "atc_eff",
)
SLOTS = ("objects", "position", "motion", "conflict")


def outputs(labels, records):
    """The score output of METHOD 6.14 either way, its denominators beside the rest."""
    output = score_cell(labels, records).to_json()
    assert score_cells([(labels, records)])[0].to_json() == output
    return output | output.pop("denominators")


def close(first, second):
    nulls = {key for key, value in first.items() if value is None}
    assert {key for key, value in second.items() if value is None} == nulls
    for key in first.keys() - nulls:
        assert first[key] == pytest.approx(second[key], rel=0, abs=1e-9), key


def blank(labels):
    """Labels at which nothing can be evaluated: every semantic denominator is 0."""
    nothing = dict.fromkeys(SLOTS)
    return replace(labels, labels=tuple(replace(item, **nothing) for item in labels.labels))


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(1), data=st.data())
def test_with_null_denominators_too(labels, records, data):
    """Bounded, indifferent to order and to strays, monotone in a right trajectory (METHOD 6.11)."""
    empty = blank(labels)
    found = outputs(empty, records)
    assert (found["semantic"], found["cia"], found["rsr"]) == (0, 0, 0)
    nulls = {"sem_cov", "sem_acc_cond", "sem_acc_eff", "sem_acc_soft", "cia_eff", "rl_s"}
    assert {key for key, value in found.items() if value is None} == nulls
    assert all(0 <= found[key] <= 1 for key in {*RATIOS, "ivcs"} - nulls)
    assert found["ivcs"] == pytest.approx(0.1 * found["jovr"] + 0.3 * found["tqsr"], abs=1e-12)
    stray = replace(data.draw(st.sampled_from(records)), t_s=100.0)
    assert outputs(empty, [*records, stray]) == found
    one, other = score_cells([(empty, records), (labels, records)])
    assert score_cells([(labels, records), (empty, records)]) == [other, one]
    pairs = paired(empty, records)
    better = [better_path(empty.labels[0], pairs[0]), *pairs[1:]]
    before, after = outputs(empty, pairs), outputs(empty, better)
    assert all(after[key] >= before[key] for key in ("jovr", "stfr", "tqsr", "ivcs"))


def moved(items, by_s):
    return [replace(item, t_s=item.t_s + by_s) for item in items]


def swapped(word):
    """Left for right and the other way round, inside longer words too."""
    if word is None:
        return None
    return word.replace("left", "*").replace("right", "left").replace("*", "right")


def mirrored_slot(slot):
    return slot if slot is None else replace(slot, value=swapped(slot.value))


def mirrored_label(label):
    return replace(
        label,
        position=swapped(label.position),
        motion=swapped(label.motion),
        lat_actions=tuple(map(swapped, label.lat_actions)),
    )


def mirrored_record(record):
    slots, path = record.slots, record.trajectory
    return replace(
        record,
        slots=replace(
            slots,
            position=mirrored_slot(slots.position),
            motion=mirrored_slot(slots.motion),
            lat_action=mirrored_slot(slots.lat_action),
        ),
        trajectory=path and replace(path, y_m=tuple(-y for y in path.y_m)),
    )


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records())
def test_a_world_in_the_mirror_scores_the_same(labels, records):
    other = replace(labels, labels=tuple(map(mirrored_label, labels.labels)))
    assert outputs(other, list(map(mirrored_record, records))) == outputs(labels, records)


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(), by=st.integers(-64, 64))
def test_the_zero_of_the_clip_s_clock_doesn_t_matter(labels, records, by):
    def shifted(by_s):
        onset = labels.risk_time_s
        return (
            replace(
                labels,
                labels=tuple(moved(labels.labels, by_s)),
                risk_time_s=None if onset is None else onset + by_s,
            ),
            moved(records, by_s),
        )

    close(outputs(*shifted(by / 8)), outputs(*shifted(0.0)))


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records())
def test_the_same_clip_twice_over_has_the_same_ratios(labels, records):
    """Doubling the protocol doubles the counts alone; what asks for the first label is off."""
    once = replace(labels, first_frame_dynamics=True, risk_time_s=labels.risk_onset_s)
    items = (*once.labels, *moved(once.labels, 64.0))
    twice = replace(once, labels=tuple(items))
    one, two = outputs(once, records), outputs(twice, [*records, *moved(records, 64.0)])
    close({key: two[key] for key in RATIOS}, {key: one[key] for key in RATIOS})
    for key in ("n", "matched", "semantic", "cia"):
        assert two[key] == 2 * one[key]


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(1))
def test_more_text_after_the_evidence_changes_nothing(labels, records):
    """Spans that lie inside stay inside; the random ones may reach beyond and are left out."""
    inside = [
        replace(record, slots=replace(record.slots, **whole_evidence(record)))
        for record in records
        if record.text.strip()
    ]
    longer = [replace(record, text=record.text + " and more") for record in inside]
    assert outputs(labels, longer) == outputs(labels, inside)


def whole_evidence(record):
    slots = {name: getattr(record.slots, name) for name in vars(record.slots)}
    span = ((0, len(record.text)),)
    return {name: slot and replace(slot, evidence=span) for name, slot in slots.items()}


def paired(labels, records):
    """Records at the labels' times, so that what is changed in one is seen."""
    pairs = zip(labels.labels, records, strict=False)
    return [replace(record, t_s=label.t_s, text="said") for label, record in pairs]


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(1), data=st.data())
def test_a_right_word_in_place_of_any_never_lowers_semantics(labels, records, data):
    records = paired(labels, records)
    i = data.draw(st.integers(0, len(records) - 1))
    slot = data.draw(st.sampled_from(SLOTS))
    truth = getattr(labels.labels[i], slot)
    if truth is None:
        return
    slots = replace(records[i].slots, **{slot: Slot(truth, ((0, 4),))})
    better = [*records]
    better[i] = replace(records[i], slots=slots)
    before, after = outputs(labels, records), outputs(labels, better)
    for key in ("sem_cov", "sem_acc_eff", "sem_acc_soft", "cia_eff", "ivcs"):
        assert after[key] is None or after[key] >= before[key] - 1e-12, key
    untouched = ("jovr", "act_acc_eff", "stfr", "tqsr", "atc_eff", "rsr", "rl_s")
    assert {key: after[key] for key in untouched} == {key: before[key] for key in untouched}


def better_path(label, record):
    """A record that drives as its label allows."""
    shift = SHIFTS[label.lat_actions[0]]
    path = Trajectory((0.0, 0.5, 1.0), (0.0, *MOVES[label.lon_actions[0]]), (0.0, shift / 2, shift))
    return replace(record, trajectory=path)


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(1), data=st.data())
def test_a_right_trajectory_in_place_of_any_never_lowers_its_scores(labels, records, data):
    records = paired(labels, records)
    i = data.draw(st.integers(0, len(records) - 1))
    better = [*records]
    better[i] = better_path(labels.labels[i], records[i])
    before, after = outputs(labels, records), outputs(labels, better)
    assert all(after[key] >= before[key] for key in ("jovr", "stfr", "tqsr"))
    same = ("sem_cov", "sem_acc_cond", "sem_acc_eff", "sem_acc_soft", "cia_eff", "act_acc_eff")
    assert {key: after[key] for key in same} == {key: before[key] for key in same}


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(1), data=st.data())
def test_losing_an_output_never_raises_what_it_can_only_feed(labels, records, data):
    records = paired(labels, records)
    i = data.draw(st.integers(0, len(records) - 1))
    before = outputs(labels, records)
    after = outputs(labels, records[:i] + records[i + 1 :])
    for key in ("matched", "jovr", "act_acc_eff", "stfr", "tqsr", "atc_eff"):
        assert after[key] <= before[key]
    for key in ("sem_cov", "sem_acc_eff", "sem_acc_soft", "cia_eff"):
        assert after[key] is None or after[key] <= before[key] + 1e-12
    assert (after["semantic"], after["cia"]) == (before["semantic"], before["cia"])


@settings(max_examples=20, deadline=None)
@given(labels=any_labels(), records=any_records(), data=st.data())
def test_a_record_between_the_labels_changes_nothing_but_the_count(labels, records, data):
    stray = data.draw(any_records(1))[0]
    t_s = data.draw(st.floats(-1, 14).filter(lambda t: all(abs(t - x.t_s) > 0.12 for x in records)))
    if any(abs(t_s - label.t_s) <= 0.12 for label in labels.labels):
        return
    more = sorted([*records, replace(stray, t_s=t_s)], key=lambda record: record.t_s)
    assert outputs(labels, more) == outputs(labels, records)
    before, after = score_cell(labels, records), score_cell(labels, more)
    assert len(after.details.unmatched_records) == len(before.details.unmatched_records) + 1
