"""Files that people write are read strictly, each failure with its place and remedy."""

from __future__ import annotations

import json
import time
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.model_errors import field_path
from ssp_core.files.reading import (
    MAX_TEXT_BYTES,
    MOST_ERRORS,
    load_model,
    parse_mapping,
    parse_model,
    parse_value,
    read_json_mapping,
    read_mapping,
    read_text,
)
from ssp_core.files.strict_json import parse_json_line
from ssp_core.files.writing import write_json
from ssp_core.files.yaml_core import CoreLoader, number_remedy
from ssp_core.run_file.faults import FaultFile
from ssp_core.run_file.values import Finite, Strict

FILE_PER_TEST = settings(
    max_examples=100,
    deadline=None,
    # The one file in tmp_path is written anew by every example.
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


class Gap(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["gap"]
    below_m: Annotated[float, Field(gt=0)]


class Arrival(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["arrival"]
    below_s: Annotated[float, Field(gt=0)]


class Row(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    condition: Annotated[Gap | Arrival, Field(discriminator="kind")]


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid")
    rows: list[Row]


def put(folder: Path, text: str, name: str = "file.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def failure(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_mapping(path)
    assert caught.value.file == str(path)
    return caught.value


# -- reading --------------------------------------------------------------------------------------


def test_a_mapping_is_read(tmp_path: Path) -> None:
    path = put(tmp_path, "a: 1\nb: [x, 2.5, null, true]\nc: {d: ü}\n")
    assert read_mapping(path) == {"a": 1, "b": ["x", 2.5, None, True], "c": {"d": "ü"}}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("110", 110), ("+5", 5), ("-0.5", -0.5), ("1.1e+2", 110.0), ("1e5", 1e5), (".5", 0.5)),
        *(("0", 0), ("0.50", 0.5), ("5.", 5.0), ("0x1F", 31), ("0o17", 15), ("1e05", 1e5)),
        *(("true", True), ("FALSE", False), ("~", None), ("", None), (".inf", float("inf"))),
        # What YAML 1.1 takes for 72, -8, 104.5, -32.1, 90, 1000, 5, True, False:
        *(("0110", "0110"), ("-010", "-010"), ("0104.5", "0104.5"), ("-0:32.1", "-0:32.1")),
        *(("1:30", "1:30"), ("1_000", "1_000"), ("0b101", "0b101"), ("on", "on"), ("no", "no")),
    ],
)
def test_a_plain_scalar_is_what_yaml_1_2_says(tmp_path: Path, text: str, value: object) -> None:
    read = read_mapping(put(tmp_path, f"a: {text}\n"))["a"]
    assert (read, type(read)) == (value, type(value))


class Numbers(Strict):
    x_m: Finite = 0.0
    n: Annotated[int, Field(ge=0)] = 0
    points: list[tuple[Finite, Finite]] = []
    by_name: dict[int, float | None] = {}


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("0110", "it has a leading zero: write 110"),
        ("-010", "it has a leading zero: write -10"),
        ("00.5", "it has a leading zero: write 0.5"),
        ("-0:32.1", "write a decimal number, without a colon"),
        ("1_000", "write 1000"),
        ("3.5 m", "write a number"),
        ("on", "write a number"),
        ("no", "write a number"),
        ("true", "write a number; true and false are none"),
        ("'7'", "it stands as text: write 7 without quotes"),
    ],
)
@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("x_m: {}", "x_m"),
        ("n: {}", "n"),
        ("points: [[0, 1], [2, {}]]", "points[1][1]"),
        ("by_name: {{'3': {}}}", "by_name.3"),
    ],
)
def test_what_is_no_number_is_refused_by_place_and_text(
    tmp_path: Path, text: str, remedy: str, line: str, field: str
) -> None:
    path = put(tmp_path, line.format(text) + "\n")
    with pytest.raises(InputError) as caught:
        load_model(Numbers, path)
    error = caught.value
    assert (error.file, error.field, error.remedy) == (str(path), field, remedy)
    assert str(error.value).lower() == text.strip("'")


def test_numbers_are_numbers(tmp_path: Path) -> None:
    path = put(tmp_path, "x_m: 1.1e+2\nn: 3.0\npoints: [[0, -0.5]]\nby_name: {'3': 0x10}\n")
    read = load_model(Numbers, path)
    assert (read.x_m, read.n, read.points, read.by_name) == (110.0, 3, [(0.0, -0.5)], {3: 16.0})


def test_missing_file_folder_and_impossible_name(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path, tmp_path / "a\0b"):
        error = failure(path)
        assert "can't be read" in error.problem


def test_size_limit_at_and_over(tmp_path: Path) -> None:
    path = tmp_path / "big.txt"
    path.write_bytes(b"x" * MAX_TEXT_BYTES)
    assert len(read_text(path)) == MAX_TEXT_BYTES
    path.write_bytes(b"x" * (MAX_TEXT_BYTES + 1))
    with pytest.raises(InputError, match="larger than 8 MiB"):
        read_text(path)
    assert len(read_text(path, 2 * MAX_TEXT_BYTES)) == MAX_TEXT_BYTES + 1


def test_not_utf8_names_the_byte(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"name: caf\xe9\n")
    assert "not UTF-8 (byte 9)" in failure(path).problem


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("a: 1\nb: *x\n", 2, "aliases"),
        ("a: &x [1]\nb: *x\n", 2, "aliases"),
        ("a: 1\nb: 2\na: 3\n", 3, "stands twice"),
        ("a: {b: 1, b: 2}\n", 1, "stands twice"),
        ('{"a": 1,\n "a": 2}', 2, "stands twice"),
        ("1: x\n", 1, "not a string"),
        ("a: 1\n? [b, c]\n: 2\n", 2, "not a string"),
        ("a: 1\nb: [\n", 3, ""),
        ("a: !!python/object/apply:os.system [id]\n", 1, "python"),
        ("<<: {a: 1}\n", 1, ""),
        ("a: !!map [1, 2]\n", 1, "mapping"),
        ("a: 1\nb: 0x" + "f" * 5000, 2, "digits"),
        ("a: 1\nb: 1" + "5" * 5000, 2, "digits"),
        ("a: !!int 0150", 1, "leading zero: write 150"),
        ("a: !!float 1:30", 1, "without a colon"),
        ("a: !!bool on", 1, "no boolean"),
        ("%TAG !a! b\n" * 102 + "---\na: 1\n", None, "more than 100 %TAG directives"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(
    tmp_path: Path, text: str, line: int | None, says: str
) -> None:
    error = failure(put(tmp_path, text))
    assert error.line == line
    assert "not valid YAML or JSON" in error.problem
    assert says in error.problem


@pytest.mark.parametrize(
    "text",
    [
        "a: !!timestamp x\n",
        "a: !!bool x\n",
        "a: !!int ''\n",
        "a: 2001-99-99\n",
        "a: !!float x\n",
        r'{"a": "\ud800"}',
        r'a: ["\uDFff"]',
    ],
)
def test_scalars_that_pyyaml_stumbles_over(tmp_path: Path, text: str) -> None:
    assert "not valid YAML or JSON" in failure(put(tmp_path, text)).problem


@pytest.mark.parametrize("text", ["", "- 1\n", "word\n", "[1, 2]", "3", "null"])
def test_the_top_must_be_a_mapping(tmp_path: Path, text: str) -> None:
    assert "mapping at its top" in failure(put(tmp_path, text)).problem


def test_a_long_text_is_read_once() -> None:
    keys = ",".join(f'"k{i}":0' for i in range(60_000))
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        parse_json_line(f'{{{keys},"k59999":1}}', "large.jsonl", 1)
    assert caught.value.field == "k59999"
    assert number_remedy("0" * 60_000 + "x") == "write a number"
    assert time.process_time() - began < 8.0


def test_a_text_is_parsed_once_and_each_reader_has_a_value_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = "speeds: {ot1: [8.5, 9.0]}\nday: 2025-03-01  # read twice\n"
    first = parse_value(text, "a.yaml")
    as_it_was = {"speeds": {"ot1": [8.5, 9.0]}, "day": date(2025, 3, 1)}
    assert first == as_it_was
    first["speeds"]["ot1"].append(10.0)
    with monkeypatch.context() as patch:
        patch.setattr(CoreLoader, "__init__", None)
        assert parse_value(text, "b.yaml") == as_it_was
        with pytest.raises(InputError, match=r"^b\.yaml: is not valid"):
            parse_value(text + "#", "b.yaml")


def test_deep_nesting_is_an_input_error(tmp_path: Path) -> None:
    for text in ("a: " + "[" * 5000, '{"a": ' + "[" * 50000 + "]" * 50000 + "}"):
        assert failure(put(tmp_path, text)).problem == (
            "is not valid YAML or JSON: it is nested too deeply"
        )


def test_json_keeps_its_own_rules(tmp_path: Path) -> None:
    """Surrogate pairs and exponents mean in JSON what JSON says."""
    value = {"text": "a \U0001f697 on the road", "small": 1e-05, "tab": "a\tb"}
    assert read_mapping(put(tmp_path, json.dumps(value), "x.json")) == value


def test_json_without_nan(tmp_path: Path) -> None:
    class Number(BaseModel):
        x: Annotated[float, Field(allow_inf_nan=False)]

    for word in ("NaN", "Infinity", "-Infinity", ".nan", ".inf"):
        with pytest.raises(InputError) as caught:
            load_model(Number, put(tmp_path, '{"x": %s}' % word))  # noqa: UP031 (braces)
        assert caught.value.field == "x"


def test_a_json_file_of_ours_has_no_nan_and_is_a_mapping(tmp_path: Path) -> None:
    for text, says in (
        ('{"x": NaN}', "is not valid JSON: NaN is no number"),
        ("x: 1", "is not valid JSON"),
        ("[1]", "must hold a mapping at its top"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            read_json_mapping(put(tmp_path, text))
        assert caught.value.file == str(tmp_path / "file.yaml")


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@FILE_PER_TEST
@given(value=st.dictionaries(st.text(), json_values, max_size=4))
def test_what_is_written_as_json_is_read_back(tmp_path: Path, value: dict[str, Any]) -> None:
    path = tmp_path / "round.json"
    write_json(path, value)
    assert read_mapping(path) == value


YAML_PIECES = [
    *"ab:-?[]{},&*!|>%@`'\"#=~ \t\n",
    *("!!int", "!!map", "!!set", "!!omap", "!!timestamp", "!!binary", "!!bool", "---", "...", "<<"),
    *(".nan", ".inf", "0x", "0o1", "1_0", "1:2", "2001-01-01", "\\u", "\\ud83d", "null", "true"),
    *("\n  ", ": ", "- "),
]
yamlish = st.lists(st.sampled_from(YAML_PIECES), max_size=14).map("".join)


@FILE_PER_TEST
@given(text=yamlish | st.text(max_size=40))
def test_any_text_gives_a_mapping_or_an_input_error(tmp_path: Path, text: str) -> None:
    path = tmp_path / "any.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        assert isinstance(read_mapping(path), dict)
    except InputError as error:
        assert error.file == str(path)  # noqa: PT017 (either outcome is right)


# -- validation -----------------------------------------------------------------------------------


def row(**condition: object) -> dict[str, Any]:
    return {"rows": [{"name": "n", "condition": condition}]}


@pytest.mark.parametrize(
    ("value", "field", "shown"),
    [
        ({}, "rows", None),
        ({"rows": [{"name": "n"}]}, "rows[0].condition", None),
        (row(kind="gap", below_m=-1), "rows[0].condition.below_m", -1),
        (row(kind="gap"), "rows[0].condition.below_m", None),
        (row(kind="gap", below_m=1, below_s=2), "rows[0].condition.below_s", 2),
        (row(kind="arrival", below_s="soon"), "rows[0].condition.below_s", "soon"),
        ({"rows": [], "extra": 5}, "extra", 5),
        ({"rows": "none"}, "rows", "none"),
    ],
)
def test_a_failure_names_the_path_in_the_file(
    value: dict[str, Any], field: str, shown: object
) -> None:
    with pytest.raises(InputError) as caught:
        parse_model(Table, value, "t.yaml")
    assert caught.value.file == "t.yaml"
    assert caught.value.field == field
    assert caught.value.value == shown


def test_all_failures_are_named_each_with_its_remedy() -> None:
    with pytest.raises(InputError) as caught:
        parse_model(Table, {"a": 1, "row": 2}, "t.yaml")
    assert str(caught.value) == (
        "t.yaml: has 3 errors:\n"
        "  rows: Field required; add it\n"
        "  a: is not a known key (got 1); known: rows\n"
        "  row: is not a known key (got 2); did you mean rows? known: rows"
    )
    in_line = caught.value.in_line(3)
    assert str(in_line).startswith("t.yaml:3: has 3 errors:\n  rows: Field required; add it\n")
    assert [one.field for one in in_line.parts] == ["rows", "a", "row"]


def test_of_another_schema_that_alone_is_named() -> None:
    with pytest.raises(InputError) as caught:
        parse_model(FaultFile, {"schema": "ssp.faults/9", "fault": []}, "f.yaml")
    assert str(caught.value).startswith("f.yaml: schema: Input should be 'ssp.faults/1'")
    with pytest.raises(InputError, match="has 2 errors"):
        parse_model(FaultFile, {"fault": [], "faults": 1}, "f.yaml")


def test_field_path() -> None:
    assert field_path(("labels", 3, "position")) == "labels[3].position"
    assert field_path((0, "a", 1, 2)) == "[0].a[1][2]"
    assert field_path(()) == ""


def test_a_field_path_has_no_names_of_a_unions_members() -> None:
    at = {"speed": {"min": "five"}, "width": 3, "names": [{}]}
    assert field_path(("speed", "Interval", "min"), at, missing=False) == "speed.min"
    assert field_path(("speed", "Interval", "unit"), at) == "speed.unit"
    assert field_path(("speed", "literal['unresolved']"), at, missing=False) == "speed"
    assert field_path(("width", "Interval"), at, missing=False) == "width"
    assert field_path(("width", "Interval"), at) == "width"
    assert field_path(("names", 0, "Name", "first"), at) == "names[0].first"


def test_a_mapping_in_bytes_is_read_as_one_in_a_file() -> None:
    assert parse_mapping(b'{"a": 1e5}', "bag:x.json") == {"a": 1e5}
    assert parse_mapping(b"a: [1, 2]\n", "bag:x.yaml") == {"a": [1, 2]}


@pytest.mark.parametrize(
    "data", [b"", b"[1]", b"a: *b", b"a: 1\na: 2", b"{", b"\xff", b"a: 1\n" + b"#" * MAX_TEXT_BYTES]
)
def test_bytes_without_a_mapping_are_named(data: bytes) -> None:
    with pytest.raises(InputError) as caught:
        parse_mapping(data, "bag:x.yaml")
    assert caught.value.file == "bag:x.yaml"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a:\n" + "- 1\n" * 600_000, "more than 500000 keys and values"),
        ("a: [" + "1," * 600_000 + "]", "more than 500000 keys and values"),
        ("".join(f"k{number}: 1\n" for number in range(300_000)), "more than 500000 keys"),
        (json.dumps({f"k{number}": 1 for number in range(500_000)}), "has 500000 errors"),
        (json.dumps({"faults": list(range(1_000_000))}), "has 1000000 errors"),
    ],
)
def test_a_file_of_many_values_is_refused_within_seconds(
    text: str, problem: str, tmp_path: Path
) -> None:
    """8 MiB of YAML took half a minute to read, and 600,000 unknown keys as long to name."""
    file = tmp_path / "faults.yaml"
    file.write_text(text)
    began_s = time.process_time()
    with pytest.raises(InputError, match=problem) as caught:
        load_model(FaultFile, file)
    assert time.process_time() - began_s < 8.0
    assert caught.value.file == str(file)
    assert caught.value.remedy
    assert "not valid" not in caught.value.problem


def test_a_file_of_too_many_values_says_what_keeps_it_from_being_json(tmp_path: Path) -> None:
    error = failure(put(tmp_path, '{"a": [' + "1," * 600_000 + "NaN]}"))
    assert error.problem == "has more than 500000 keys and values, the most that are read as YAML"
    assert str(error.remedy).endswith("the JSON, which may have more: NaN is no number")


def test_a_file_of_many_errors_names_each_up_to_a_bound(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        parse_model(FaultFile, {f"k{number}": 1 for number in range(MOST_ERRORS)}, "f.yaml")
    assert len(caught.value.parts) == MOST_ERRORS
