"""Malformed K* files: an answer that names file and field, and never a traceback or a hang."""

from __future__ import annotations

import copy
import json
import re
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.event_spec.fields import leaves, split
from ssp_scenario_manager.event_spec.load import load_event, read_event_file
from ssp_scenario_manager.maps.site import find_shipped

GOOD = find_shipped("cut_in", "event").read_text()
LANE = "vut_lane: {value: rightmost, identity: true}"

# What no YAML file may do is tested with the reader of files.
HOSTILE = {
    "truncated": GOOD[: len(GOOD) // 3],
    "a cycle": "a: &a [*a]\n",
    "deep within reason": "topology: " + "{a: " * 60 + "1" + "}" * 60,
    "not a number": GOOD.replace("max: 14,", "max: .nan,"),
    "infinite": GOOD.replace("max: 14,", "max: .inf,"),
    "a huge number": GOOD.replace("max: 14,", f"max: {'9' * 400},"),
    "a date": GOOD.replace(LANE, "vut_lane: 2026-01-01"),
    "a number as key": GOOD + "7: x\n",
    "a lone surrogate in a text": json.dumps(
        yaml.safe_load(GOOD) | {"description": "\ud800"}, ensure_ascii=True
    ),
    "a huge frame": GOOD.replace("frames: [0, 77]", f"frames: [0, {'9' * 400}]"),
    "a long name": GOOD.replace("  vut:\n", "  " + "x" * 5000 + ": {}\n  vut:\n"),
    "many unknown keys": GOOD + "".join(f"k{i}: 1\n" for i in range(15_000)),
    "a thousand participants": GOOD.replace(
        "participants:\n", "participants:\n" + "".join(f"  p{i}: {{}}\n" for i in range(1000))
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_check_answers_a_hostile_file(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hostile.event.yaml"
    file.write_text(HOSTILE[case], errors="surrogatepass")
    began = time.process_time()
    assert main(["spec", "check", "--json", str(file)]) == 1
    assert time.process_time() - began < 20.0
    (report,) = json.loads(capsys.readouterr().out)
    assert report["ok"] is False
    assert report["error"] or report["failures"]
    assert "Traceback" not in str(report)
    for command in (
        ["graph", str(file), "--out", str(tmp_path / "out")],
        ["diff", str(file), "cut_in"],
    ):
        began = time.process_time()
        assert main(["spec", *command]) == 1
        assert time.process_time() - began < 20.0
    assert not (tmp_path / "out").exists()


def test_file_beyond_the_limit_is_refused_at_once(tmp_path: Path) -> None:
    file = tmp_path / "huge.event.yaml"
    with file.open("wb") as stream:
        stream.write(GOOD.encode())
        stream.truncate(1 << 40)  # more than any memory takes
    with pytest.raises(InputError, match="larger than 256 KiB"):
        load_event(str(file))


def test_file_that_is_not_there_or_a_folder_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = (
        str(tmp_path / "no.event.yaml"),
        str(tmp_path),
        "no_such_event",
        "a\x00.yaml",
        "a" * 5000,
    )
    for name in names:
        assert main(["spec", "check", name]) == 1
    assert "no_such_event" in capsys.readouterr().out


_SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.dates()
)
_ANYTHING = st.recursive(
    _SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=12,
)
_SHIPPED: dict[str, Any] = yaml.safe_load(GOOD)
_PATHS = [path for path, _ in leaves(_SHIPPED) if not path.startswith("uncertainty")]


@given(_ANYTHING)
@settings(max_examples=60, deadline=None)
def test_check_never_raises_on_any_mapping(value: Any) -> None:
    assert check_event({"schema": "ssp.event/2", "topology": value, "name": value})


@given(st.lists(st.tuples(st.sampled_from(_PATHS), _ANYTHING), min_size=1, max_size=5))
@settings(max_examples=80, deadline=None)
def test_check_never_raises_on_a_spoilt_event(changes: list[tuple[str, Any]]) -> None:
    value = copy.deepcopy(_SHIPPED)
    for path, changed in changes:
        at = value
        *parents, last = split(path)
        try:
            for key in parents:
                at = at[key]
            at[last] = changed
        except (TypeError, LookupError):
            continue
    for failure in check_event(value):
        assert failure.field
        assert failure.reason
        assert failure.remedy


def test_what_a_file_says_commands_no_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hostile = "seen\x1b]0;owned\x07\x1b[2J"
    value = copy.deepcopy(read_event_file("cut_in")[0])
    value["description"] = hostile
    value["topology"]["segment"] = hostile
    value["participants"][hostile] = value["participants"]["ot1"]
    bad = tmp_path / "bad.event.yaml"
    bad.write_text(json.dumps(value))
    assert main(["spec", "check", str(bad)]) == 1
    assert main(["spec", "graph", str(bad)]) == 1
    value = copy.deepcopy(read_event_file("cut_in")[0])
    value["description"] = hostile
    other = tmp_path / "other.event.yaml"
    other.write_text(json.dumps(value))
    assert main(["spec", "diff", "cut_in", str(other)]) == 1
    told = capsys.readouterr()
    for text in (told.out, told.err):
        assert r"\x1b]0;owned\x07" in text
        assert "\x1b]0" not in text
        assert "\x07" not in text
        assert "\x1b[2J" not in text


@pytest.mark.parametrize(
    ("path", "new", "field"),
    [
        ("constraints.speeds.vut.approach.min", "five", "constraints.speeds.vut.approach.min"),
        ("constraints.speeds.vut.approach", 3, "constraints.speeds.vut.approach"),
        ("topology.left_boundary.value", {}, "topology.left_boundary.value"),
    ],
)
def test_a_field_is_named_as_the_file_names_it(
    path: str, new: Any, field: str, tmp_path: Path
) -> None:
    value = copy.deepcopy(read_event_file("cut_in")[0])
    *parents, last = split(path)
    node: Any = value
    for part in parents:
        node = node[part]
    node[last] = new
    bad = tmp_path / "bad.event.yaml"
    bad.write_text(json.dumps(value))
    # One error, or each of a choice's on a line of its own.
    with pytest.raises(InputError, match=rf"(yaml: |\n  ){re.escape(field)}: "):
        load_event(str(bad))
