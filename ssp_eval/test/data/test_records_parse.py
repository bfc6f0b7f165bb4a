"""Behaviour records (METHOD 5.3, 5.6): what is refused, what is a model's output, round trips."""

import copy
import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_eval.data.records import (
    VOCABULARIES,
    BehaviourRecord,
    Slot,
    Slots,
    load_records,
    parse_records,
    record_to_json,
)
from ssp_vla_bridge.trajectory import INVALID_REASONS, Trajectory, check_trajectory

GOOD = {
    "schema": "ssp.record/1",
    "t_s": 0.02,
    "text": "A car is merging",
    "slots": {
        "objects": {"value": ["car"], "evidence": [[2, 5]]},
        "position": {"value": "front_right", "evidence": [[2, 5], [9, 16]]},
        "motion": None,
        "conflict": None,
        "lon_action": {"value": "decelerate", "evidence": [[9, 16]]},
        "lat_action": None,
    },
    "trajectory": {"t_s": [0.0, 0.5, 1.0], "x_m": [0.0, 4.0, 7.5], "y_m": [0.0, 0.0, 0.1]},
    "invalid": [],
    "adapter": {"name": "openemma", "mode": "corrected", "origin_added": False, "notes": ["x"]},
}
REMOVE = object()


def changed(path, value):
    """GOOD with one value replaced, added or (REMOVE) taken away; path is ``a.b.0``."""
    record = copy.deepcopy(GOOD)
    *parents, last = path.split(".")
    holder = record
    for key in parents:
        holder = holder[int(key) if isinstance(holder, list) else key]
    key = int(last) if isinstance(holder, list) else last
    if value is REMOVE:
        del holder[key]
    else:
        holder[key] = value
    return record


def parse(*records):
    return parse_records("\n".join(json.dumps(record) for record in records), "r.jsonl")


def test_a_record_is_read_as_it_stands():
    assert parse(GOOD) == (
        BehaviourRecord(
            t_s=0.02,
            text="A car is merging",
            slots=Slots(
                objects=Slot(("car",), ((2, 5),)),
                position=Slot("front_right", ((2, 5), (9, 16))),
                lon_action=Slot("decelerate", ((9, 16),)),
            ),
            trajectory=Trajectory((0.0, 0.5, 1.0), (0.0, 4.0, 7.5), (0.0, 0.0, 0.1)),
            invalid=(),
            adapter=GOOD["adapter"],
        ),
    )


@pytest.mark.parametrize("value", [REMOVE, None])
def test_the_adapter_is_optional(value):
    assert parse(changed("adapter", value))[0].adapter is None


def test_words_repeated_in_a_set_count_once():
    (record,) = parse(changed("slots.objects.value", ["car", "bus", "car"]))
    assert record.slots.objects.value == ("car", "bus")


def test_a_null_value_is_a_missing_slot_and_an_empty_set_is_an_answer():
    assert parse(changed("slots.objects.value", None))[0].slots.objects is None
    assert parse(changed("slots.objects.value", []))[0].slots.objects.value == ()


@pytest.mark.parametrize("span", [[0, 99], [-3, 2], [5, 2], [3, 3], [0, 10**400]])
def test_spans_that_support_nothing_are_kept_and_no_error(span):
    (record,) = parse(changed("slots.position.evidence", [span]))
    assert record.slots.position.evidence == (tuple(span),)


TWICE = [
    ('"t_s": 0.02', '"t_s": 9.0', "t_s"),
    ('"text": "A car is merging"', '"text": "A: car"', "text"),
    ('"text": "A car is merging"', '"text" : "A car"', "text"),
    # As many colons as a line has with each key once and the text that is left.
    ('"text": "A car is merging"', r'"text": "\u003a"', "text"),
    ('"motion": null', '"motion": null', "motion"),
    ('"value": ["car"]', '"value": []', "value"),
    ('"y_m": [0.0, 0.0, 0.1]', '"y_m": [0.0, 0.0, 0.1]', "y_m"),
    ('"mode": "corrected"', '"mode": ":"', "mode"),
]


@pytest.mark.parametrize(("once", "again", "key"), TWICE)
def test_a_key_that_stands_twice_is_refused(once: str, again: str, key: str) -> None:
    line = json.dumps(GOOD)
    assert line.count(once) == 1
    twice = line.replace(once, f"{once}, {again}")
    with pytest.raises(InputError, match=f"^r.jsonl:1: {key}: stands twice.*keep one of the two"):
        parse_records(twice, "r.jsonl")


@pytest.mark.parametrize("path", ["text", "adapter.name", "adapter.notes.0"])
@pytest.mark.parametrize("text", ["So: a car", "it is ::", '"so":', "a\t: b", r"\u003a", ""])
def test_colons_in_texts_are_no_keys(path: str, text: str) -> None:
    (record,) = parse(changed(path, text))
    found = record.text if path == "text" else record.adapter
    assert text in (found if path == "text" else [found["name"], *found["notes"]])


REFUSED = [
    ("schema", "ssp.record/2", "schema"),
    ("schema", 1, "schema"),
    *[(key, REMOVE, key) for key in GOOD if key != "adapter"],
    ("extra", 1, "extra"),
    ("t_s", "0.0", "t_s"),
    ("t_s", True, "t_s"),
    ("t_s", None, "t_s"),
    ("t_s", math.nan, "t_s"),
    ("t_s", math.inf, "t_s"),
    ("t_s", 10**400, "t_s"),
    ("text", None, "text"),
    ("text", ["a"], "text"),
    ("slots", None, "slots"),
    ("slots", [], "slots"),
    *[(f"slots.{name}", REMOVE, f"slots.{name}") for name in VOCABULARIES],
    ("slots.speed", None, "slots.speed"),
    ("slots.motion", "oncoming", "slots.motion"),
    ("slots.motion", {"value": "flying", "evidence": []}, "slots.motion.value"),
    ("slots.motion", {"value": ["oncoming"], "evidence": []}, "slots.motion.value"),
    ("slots.motion", {"value": "oncoming"}, "slots.motion.evidence"),
    ("slots.motion", {"value": "oncoming", "evidence": [], "z": 1}, "slots.motion.z"),
    ("slots.objects.value", "car", "slots.objects.value"),
    ("slots.objects.value", ["car", "tram"], "slots.objects.value[1]"),
    ("slots.objects.value", [None], "slots.objects.value[0]"),
    ("slots.objects.value", [["car"]], "slots.objects.value[0]"),
    ("slots.position.value", "Front", "slots.position.value"),
    ("slots.position.value", {}, "slots.position.value"),
    ("slots.position.evidence", None, "slots.position.evidence"),
    ("slots.position.evidence", [3, 5], "slots.position.evidence[0]"),
    ("slots.position.evidence.1", [3], "slots.position.evidence[1][1]"),
    ("slots.position.evidence.1", [3, 4, 5], "slots.position.evidence[1]"),
    ("slots.position.evidence.1", [3, 4.0], "slots.position.evidence[1][1]"),
    ("slots.position.evidence.1", ["3", 4], "slots.position.evidence[1][0]"),
    ("slots.position.evidence.1", [True, 4], "slots.position.evidence[1][0]"),
    ("slots.position.evidence.1", [None, 4], "slots.position.evidence[1][0]"),
    ("trajectory", "none", "trajectory"),
    ("trajectory", [], "trajectory"),
    ("trajectory", {}, "trajectory.t_s"),
    ("trajectory.y_m", REMOVE, "trajectory.y_m"),
    ("trajectory.z_m", [], "trajectory.z_m"),
    ("trajectory.x_m", None, "trajectory.x_m"),
    ("trajectory.x_m", 4.0, "trajectory.x_m"),
    ("trajectory.x_m.1", "4.0", "trajectory.x_m[1]"),
    ("trajectory.x_m.1", False, "trajectory.x_m[1]"),
    ("trajectory.x_m.1", [4.0], "trajectory.x_m[1]"),
    ("trajectory.x_m.1", {}, "trajectory.x_m[1]"),
    ("invalid", None, "invalid"),
    ("invalid", "shape", "invalid"),
    ("invalid", ["tired"], "invalid[0]"),
    ("adapter", "openemma", "adapter"),
    ("adapter.notes", REMOVE, "adapter.notes"),
    ("adapter.version", 1, "adapter.version"),
    ("adapter.origin_added", 0, "adapter.origin_added"),
    ("adapter.notes", [1], "adapter.notes[0]"),
]


@pytest.mark.parametrize(("path", "value", "field"), REFUSED)
def test_refusals_name_file_line_and_field(path, value, field):
    with pytest.raises(InputError) as caught:
        parse(GOOD | {"t_s": -1.0}, changed(path, value))
    assert (caught.value.file, caught.value.line, caught.value.field) == ("r.jsonl", 2, field)
    assert str(caught.value).startswith(f"r.jsonl:2: {field}: ")


@pytest.mark.parametrize("later", [0.02, 0.01, -0.0])
def test_times_must_rise_strictly(later):
    with pytest.raises(InputError, match=r"^r\.jsonl:3: t_s: must rise strictly") as caught:
        parse_records(f"{json.dumps(GOOD)}\n\n{json.dumps(GOOD | {'t_s': later})}\n", "r.jsonl")
    assert caught.value.line == 3


@pytest.mark.parametrize(
    ("trajectory", "reasons"),
    [
        (([], [], []), ("shape",)),
        (([0.0], [0.0], [0.0]), ("shape", "coverage")),
        (([0.0, 1.0], [0.0], [0.0, 0.0]), ("shape",)),
        (([0.0, 1.0], [0.0, None], [0.0, 0.0]), ("non_finite",)),
        (([0.0, 1.0], [0.0, math.nan], [0.0, 0.0]), ("non_finite",)),
        (([0.0, 1.0], [0.0, math.inf], [0.0, -math.inf]), ("non_finite",)),
        (([0.0, 1.0], [0.0, 10**400], [0.0, -(10**400)]), ("non_finite",)),
        (([0.0, None], [0.0, 1.0], [0.0, 0.0]), ("non_finite",)),
        (([0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3), ("timestamps",)),
        (([1.0, 0.0], [0.0] * 2, [0.0] * 2), ("timestamps",)),
        (([0.0, 0.999], [0.0] * 2, [0.0] * 2), ("coverage",)),
        (([0.1, 1.0], [0.0] * 2, [0.0] * 2), ("coverage",)),
        (([0, 1], [0, 1], [0, 0]), ()),
    ],
)
def test_a_wrong_trajectory_is_read_and_found_invalid(trajectory, reasons):
    t_s, x_m, y_m = trajectory
    (record,) = parse(changed("trajectory", {"t_s": t_s, "x_m": x_m, "y_m": y_m}))
    assert check_trajectory(record.trajectory) == reasons


@pytest.mark.parametrize("number", ["1e999", "-1e999", "9" * 400])
def test_numbers_beyond_a_double_are_not_finite(number):
    line = json.dumps(GOOD).replace("7.5", number)
    (record,) = parse_records(line, "r.jsonl")
    assert math.isinf(record.trajectory.x_m[2])


@pytest.mark.parametrize(
    "line",
    [
        "{",
        "nonsense",
        "{}{}",
        "{'t_s': 1}",
        '{"t_s": 1,}',
        '"\x01"',
        "[" * 100_000,
        '{"a":' * 100_000,
        "\ufeff{}",
        "\u00a0",
        "null",
        "[]",
        "3",
        '"text"',
        '{"\\ud800": 1}',
        '{"' + "k" * 10_000 + '": 1}',
    ],
    ids=lambda line: ascii(line)[:12],
)
def test_garbage_is_refused_with_its_line(line):
    with pytest.raises(InputError) as caught:
        parse_records(f"{json.dumps(GOOD)}\n{line}\n", "r.jsonl")
    assert caught.value.line == 2
    assert len(str(caught.value)) < 500
    str(caught.value).encode()


def test_bom_blank_lines_and_crlf_are_accepted(tmp_path):
    path = tmp_path / "records.jsonl"
    lines = ["", json.dumps(GOOD), " \t", json.dumps(GOOD | {"t_s": 1}), "", ""]
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode())
    assert [record.t_s for record in load_records(path)] == [0.02, 1.0]


def test_a_line_separator_inside_a_text_ends_no_line():
    line = json.dumps(GOOD | {"text": "A car\u2028is\u0085merging"}, ensure_ascii=False)
    assert parse_records(line, "r.jsonl")[0].text == "A car\u2028is\u0085merging"


def test_no_records_are_a_silent_model(tmp_path):
    path = tmp_path / "records.jsonl"
    path.write_bytes(b"")
    assert load_records(path) == ()


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.jsonl"):
        load_records(tmp_path / "nowhere.jsonl")
    binary = tmp_path / "binary.jsonl"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"binary\.jsonl: is not UTF-8"):
        load_records(binary)


finite = st.floats(allow_nan=False, allow_infinity=False)
spans = st.lists(st.tuples(st.integers(), st.integers()), max_size=3).map(tuple)
any_text = st.text(max_size=20)


def slot(name):
    words = st.sampled_from(VOCABULARIES[name])
    values = st.lists(words, unique=True).map(tuple) if name == "objects" else words
    return st.none() | st.builds(Slot, values, spans)


coordinates = st.lists(finite, max_size=4).map(tuple)
records = st.builds(
    BehaviourRecord,
    t_s=st.floats(-86_400, 86_400),
    text=any_text,
    slots=st.builds(Slots, **{name: slot(name) for name in VOCABULARIES}),
    trajectory=st.none() | st.builds(Trajectory, coordinates, coordinates, coordinates),
    invalid=st.lists(st.sampled_from(INVALID_REASONS), unique=True).map(tuple),
    adapter=st.none()
    | st.fixed_dictionaries(
        {
            "name": any_text,
            "mode": any_text,
            "origin_added": st.booleans(),
            "notes": st.lists(any_text, max_size=2),
        }
    ),
)


@settings(max_examples=100, deadline=None)
@given(records)
def test_writing_and_reading_give_the_same_record(record):
    line = record_to_json(record)
    assert "\n" not in line
    line.encode()
    assert parse_records(line, "r.jsonl") == (record,)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_written_as_null_and_stay_invalid(value):
    record = BehaviourRecord(0.0, "", trajectory=Trajectory((0.0, 1.0), (0.0, value), (0.0, 0.0)))
    line = record_to_json(record)
    assert json.loads(line)["trajectory"]["x_m"] == [0.0, None]
    (read,) = parse_records(line, "r.jsonl")
    assert check_trajectory(read.trajectory) == check_trajectory(record.trajectory)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["value", "evidence", "t_s", "x_m", "y_m"]), inner)
    ),
    max_leaves=6,
)
PLACES = [*GOOD, *(f"slots.{name}" for name in VOCABULARIES), "trajectory.x_m", "adapter.name"]


@settings(max_examples=100, deadline=None)
@given(place=st.sampled_from(PLACES), value=json_values)
def test_any_value_anywhere_is_read_or_refused(place, value):
    try:
        refusal = None
        parse(changed(place, value))
    except InputError as error:
        refusal = error
    if refusal is not None:
        assert refusal.line == 1
        assert refusal.field is not None
        assert refusal.field.startswith(place.split(".")[0])


@settings(max_examples=100, deadline=None)
@given(st.text(st.sampled_from('{}[]",:1e.-NaInfity\\u \n\r\t\ufeff'), max_size=30))
def test_any_text_is_read_or_refused(text):
    try:
        refusal = None
        parse_records(text, "r.jsonl")
    except InputError as error:
        refusal = error
    assert refusal is None or refusal.file == "r.jsonl"


def test_many_long_answers_are_no_error(tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    lines = [json.dumps({**GOOD, "t_s": t_s, "text": "z" * (1 << 20)}) for t_s in range(9)]
    file.write_text("\n".join(lines))
    assert [record.t_s for record in load_records(file)] == list(range(9))
