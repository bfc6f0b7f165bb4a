"""Reading records in bulk gives what reading them value by value gives, or nothing (METHOD 5.3)."""

import json
import math
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_eval.data import records as strictly
from ssp_eval.data.records import load_records, read_lines, record_to_json

sys.path.insert(0, str(Path(__file__).parent))

from score_inputs import any_records
from test_records_parse import GOOD, REFUSED, changed

GOLDEN = sorted((Path(__file__).parents[2] / "tests" / "golden").glob("*/records.jsonl"))
LINE = json.dumps(GOOD)


def in_bulk(text):
    """The records of a text, None where the bulk reader leaves them to the strict one."""
    lines = read_lines([text])
    return None if lines is None else strictly._records_of(lines)


def agree(text):
    """Whether the bulk reader took the text; if so, the strict one reads the same."""
    found = in_bulk(text)
    if found is not None:
        # By their text: NaN isn't equal to itself, and True and 1 are.
        assert repr(found) == repr(strictly._parse_strictly(text, "r.jsonl"))
    return found is not None


@pytest.mark.parametrize("file", GOLDEN, ids=lambda file: file.parent.name)
def test_golden_files(file):
    assert agree(file.read_text())


@settings(max_examples=50, deadline=None)
@given(any_records())
def test_whatever_our_writer_writes_is_read_in_bulk(records):
    assert agree("".join(f"{record_to_json(record)}\n" for record in records))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\n \n",
        f"\ufeff{LINE}\r\n\r\n",
        json.dumps(GOOD | {"text": 'He said: "left": now \\" and\ttab \u00e9 \U0001f697'}),
        json.dumps(GOOD | {"text": 'He said: "left": now é 🚗'}, ensure_ascii=False),
        json.dumps(GOOD | {"text": "attention : piéton"}),
        json.dumps(GOOD | {"text": ' A car on the "left" : "right"'}),
        LINE.replace('": ', '":\t').replace(", ", " ,  "),
        json.dumps(GOOD, separators=(",", ":")),
        json.dumps(GOOD | {"adapter": None}),
        json.dumps({key: GOOD[key] for key in reversed(GOOD) if key != "adapter"}),
        LINE.replace("0.02", "1"),
        LINE.replace("7.5", "null"),
        LINE.replace("7.5", "NaN").replace("4.0", "-Infinity"),
        LINE.replace("7.5", "1e999"),
        LINE.replace("7.5", str(1 << 53)),
        LINE.replace("[2, 5]", str([0, 10**40])),
        LINE.replace('"car"', '"car", "bus", "car"'),
    ],
)
def test_forms_that_are_read_in_bulk(text):
    assert agree(text)


@pytest.mark.parametrize(
    "text",
    [
        LINE.replace('"x_m":', '"x_m" :'),
        LINE.replace('"x_m":', '"x_m"\t:'),
        LINE.replace('"x_m":', '"x_m"\r:'),
        LINE.replace("7.5", str((1 << 53) + 1)),
        LINE.replace("7.5", str(-(1 << 53) - 1)),
        LINE.replace("7.5", str(10**400)),
        json.dumps(GOOD | {"text": "\ud800"}),
    ],
)
def test_forms_that_are_left_to_the_strict_reader_and_right(text):
    assert in_bulk(text) is None
    assert len(strictly.parse_records(text, "r.jsonl")) == 1


@pytest.mark.parametrize(("path", "value", "field"), REFUSED)
def test_what_is_refused_is_never_taken(path, value, field):
    assert in_bulk(json.dumps(changed(path, value))) is None


@pytest.mark.parametrize("key", ["schema", "slots", "position", "evidence", "x_m", "notes"])
@pytest.mark.parametrize("again", ['"{}": {}, ', '"{}" : {}, ', '"{}"\t:{},', '"{}":{},'])
def test_a_key_that_stands_twice_is_never_taken(key, again):
    """The second of the two is the one that the record has anyway, so that all else is right."""
    assert f'"{key}": ' in LINE
    twice = LINE.replace(f'"{key}": ', again.format(key, "null") + f'"{key}": ', 1)
    assert in_bulk(twice) is None
    with pytest.raises(InputError, match="stands twice"):
        strictly.parse_records(twice, "r.jsonl")


def test_a_doubled_key_in_one_record_isn_t_hidden_by_room_in_another():
    twice = LINE.replace('"x_m": ', '"x_m": [], "x_m": ')
    roomy = LINE.replace('"y_m": ', '"y_m" : ').replace("0.02", "0.5")
    assert in_bulk(f"{twice}\n{roomy}") is None


def test_times_rise_within_a_file_alone():
    later = LINE.replace("0.02", "0.03")
    assert read_lines([f"{later}\n{LINE}"]) is None
    assert read_lines([f"{LINE}\n{LINE}"]) is None
    lines = read_lines([f"{LINE}\n{later}", "", LINE, later])
    assert lines is not None
    assert lines.counts == [2, 0, 1, 1]
    assert lines.t_s == [0.02, 0.03, 0.02, 0.03]


def test_one_file_in_doubt_is_enough():
    assert read_lines([LINE, "{}"]) is None


PIECES = [
    "null", "true", "1", "-1", "0.5", "1e400", "NaN", "[]", "{}", '""', '"car"', '"front"',
    "[1, 2]", '"t_s": 1, ', '"value": null, ', '"x_m" : [], ', ", ", ": ", " ", "\t", "\r", "\n",
    '"', "\\", '\\"', "[", "]", "{", "}", "e", "-", ".", "0", "\x00", "\u00a0", "\ufeff", "//", "'",
]  # fmt: skip


@st.composite
def damaged(draw):
    """A right line in which something was put in, taken out or replaced, up to three times."""
    text = draw(st.sampled_from([LINE, f"{LINE}\n{LINE.replace('0.02', '7')}"]))
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = start + draw(st.sampled_from([0, 0, 1, 2, 5]))
        text = text[:start] + draw(st.sampled_from(["", *PIECES])) + text[end:]
    return text


@settings(max_examples=400, deadline=None)
@given(damaged())
def test_a_damaged_file_is_never_taken_for_another(text):
    agree(text)


def test_the_records_of_a_file_are_objects_as_before(tmp_path):
    file = tmp_path / "records.jsonl"
    file.write_text(LINE.replace("7.5", "null"))
    (record,) = load_records(file)
    assert math.isnan(record.trajectory.x_m[2])
    assert record.slots.position.evidence == ((2, 5), (9, 16))
    assert record.adapter == GOOD["adapter"]
