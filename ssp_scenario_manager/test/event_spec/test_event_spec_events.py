"""K* files: versions, part U and its seals, units, text, and agreement with the source clips."""

from __future__ import annotations

import copy
import math
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_value
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.event_spec.fields import (
    UNITS,
    Span,
    get,
    granules,
    join,
    leaves,
    matches,
    owner,
    split,
    units_of,
)
from ssp_scenario_manager.event_spec.load import (
    body,
    event_text,
    event_version,
    load_event,
    read_event_file,
    safety_critical_fields,
    seal_event,
    seals,
    uncovered,
)
from ssp_scenario_manager.event_spec.model import Doubt, Event, Interval
from ssp_scenario_manager.maps.site import find_shipped
from ssp_scenario_manager.scenarios.events.kinds import KINDS

NAMES = tuple(sorted(KINDS))


@pytest.fixture(params=NAMES)
def event(request: pytest.FixtureRequest) -> Event:
    return load_event(request.param)[0]


_SHIPPED = read_event_file("cut_in")[0]
_EVENT, _VERSION = load_event("cut_in")


def _shuffled(value: Any, order: random.Random) -> Any:
    if isinstance(value, dict):
        items = list(value.items())
        order.shuffle(items)
        return {key: _shuffled(item, order) for key, item in items}
    return [_shuffled(item, order) for item in value] if isinstance(value, list) else value


@given(st.integers())
@settings(max_examples=20, deadline=None)
def test_order_of_keys_does_not_change_the_version(seed: int) -> None:
    value = _SHIPPED
    shuffled = Event.model_validate(_shuffled(value, random.Random(seed)))
    assert event_version(shuffled) == _VERSION


def test_comments_defaults_and_spelling_of_numbers_do_not_change_the_version(
    tmp_path: Path,
) -> None:
    text = find_shipped("cut_in", "event").read_text()
    changed = text.replace("max: 14,", "max: 14.0,").replace("# I:", "# something else:")
    changed = changed.replace("  zone: vut_lane\n", "  zone: vut_lane\n  occluder: null\n")
    changed = changed.replace("[decelerate, stop]", "[stop, decelerate]")
    changed = changed.replace("{min: 0, max: 0, unit: m}", "{min: -0.0, max: 0, unit: m}")
    for written in ("14.0", "occluder", "[stop, dec", "-0.0"):
        assert written in changed
    file = tmp_path / "other.event.yaml"
    file.write_text(changed)
    assert load_event(str(file))[1] == load_event("cut_in")[1]


def test_every_change_of_a_value_changes_the_version(event: Event) -> None:
    known = {event_version(event)}
    value = event.model_dump(mode="json", by_alias=True)
    for path in ("constraints.safety.speed.max", "events.clip.end.max", "source.rate.min"):
        changed = copy.deepcopy(value)
        *parents, last = split(path)
        get(changed, join(tuple(parents)))[last] += 0.001
        known.add(event_version(Event.model_validate(changed)))
    assert len(known) == 4


def test_unknown_event_and_wrong_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=", ".join(NAMES)):
        load_event("no_such")
    file = tmp_path / "bad.event.yaml"
    text = find_shipped("cut_in", "event").read_text()
    file.write_text(text.replace("role: VUT", "role: EGO").replace("class: car", "class: tram"))
    with pytest.raises(InputError, match=r"bad\.event\.yaml: has 3 errors:\n  participants"):
        load_event(str(file))


def test_text_gives_the_same_event_and_is_how_the_shipped_ones_are_written(event: Event) -> None:
    assert event_text(event) == find_shipped(event.name, "event").read_text()


_WORDS = st.text(alphabet=st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=40)


@given(_WORDS, _WORDS)
@settings(max_examples=200, deadline=None)
def test_any_words_survive_writing(description: str, source: str) -> None:
    doubt = Doubt(confidence=0.3, provenance="model", source=source, review="unreviewed")
    changed = _EVENT.model_copy(
        update={"description": description, "uncertainty": {"topology.segment": doubt}}
    )
    assert Event.model_validate(parse_value(event_text(changed), "event.yaml")) == changed


def test_part_u_covers_every_field_with_a_seal_that_holds(event: Event) -> None:
    assert uncovered(event) == []
    assert {path: entry.seal for path, entry in event.uncertainty.items()} == seals(event)
    assert set(event.uncertainty) == set(granules(body(event)))
    assert seal_event(event) == event


def test_seal_covers_value_and_what_is_known_of_it(event: Event) -> None:
    path = "constraints.time_gap"
    seal, entry = seals(event)[path], event.uncertainty[path]
    for change in (
        {"confidence": 0.1},
        {"provenance": "model"},
        {"source": "elsewhere"},
        {"review": "edited"},
    ):
        entries = dict(event.uncertainty) | {path: entry.model_copy(update=change)}
        assert seals(event.model_copy(update={"uncertainty": entries}))[path] != seal


def test_holder_is_sealed_without_what_has_an_entry_of_its_own(event: Event) -> None:
    entries = dict(event.uncertainty)
    own = [path for path in entries if path.startswith("topology.")]
    kept = {path: entry for path, entry in entries.items() if path not in own}
    doubt = Doubt(confidence=1, provenance="person", source="seen", review="accepted")
    kept |= {"topology": doubt, "topology.segment": doubt}
    first = seal_event(event.model_copy(update={"uncertainty": kept}))
    assert check_event(first) == []
    topology = event.topology.model_copy(
        update={"segment": event.topology.segment.model_copy(update={"value": "curve"})}
    )
    second = first.model_copy(update={"topology": topology})
    changed = [f.field for f in check_event(second) if f.reason == "changed since it was reviewed"]
    assert changed == ["topology.segment"]


def test_seal_of_one_entry_leaves_the_others_alone(event: Event) -> None:
    entries = {
        path: entry.model_copy(update={"seal": None}) for path, entry in event.uncertainty.items()
    }
    bare = event.model_copy(update={"uncertainty": entries})
    sealed = seal_event(bare, ["topology.segment"])
    done = [path for path, entry in sealed.uncertainty.items() if entry.seal]
    assert done == ["topology.segment"]
    with pytest.raises(KeyError):
        seal_event(bare, ["topology.nothing"])


def test_unreviewed_safety_critical_field_fails_and_another_may_wait(event: Event) -> None:
    for path, fails in (("constraints.trigger.below", True), ("topology.curvature", False)):
        entry = event.uncertainty[path].model_copy(update={"review": "unreviewed", "seal": None})
        entries = dict(event.uncertainty) | {path: entry}
        found = check_event(event.model_copy(update={"uncertainty": entries}))
        assert [f.field for f in found] == ([path] if fails else [])


def test_safety_critical_table_names_fields_that_are_there(event: Event) -> None:
    found = safety_critical_fields(event)
    assert "constraints.safety.speed" in found
    assert "interaction.passing_order" in found
    assert "topology.road_type" not in found


def test_manoeuvre_units_are_known() -> None:
    for kind in KINDS.values():
        assert set(kind.manoeuvre.values()) <= set(UNITS)


@pytest.mark.parametrize(
    ("low", "high", "unit", "expected"),
    [
        (36, 72, "km/h", Span(10.0, 20.0)),
        (500, None, "ms", Span(0.5, math.inf)),
        (None, 180, "deg", Span(-math.inf, math.pi)),
        (50, 100, "%", Span(0.5, 1.0)),
        (2, 3, "m", Span(2.0, 3.0)),
    ],
)
def test_units_convert_to_si(
    low: float | None, high: float | None, unit: str, expected: Span
) -> None:
    span = Interval(min=low, max=high, unit=unit).si
    assert span.low == pytest.approx(expected.low)
    assert span.high == pytest.approx(expected.high)


def test_unknown_unit_is_an_error() -> None:
    with pytest.raises(ValueError, match="furlong"):
        _ = Interval(min=1, max=2, unit="furlong").si
    assert units_of("speed") == ["m/s", "km/h"]


def test_paths_split_and_match() -> None:
    path = "events.trigger.evidence[0].frames[1]"
    assert join(split(path)) == path
    for wrong in ("", ".a", "a.", "a..b", "[x]", "a[", "a]"):
        assert split(wrong) == ()
    assert matches("constraints.speeds.ot1.trigger", "constraints.speeds.*.*")
    assert not matches("constraints.speeds.ot1", "constraints.speeds.*.*")
    assert owner("motion.ot1.trigger.lateral", {"motion.ot1": 1, "motion": 2}) == "motion.ot1"
    assert owner("motion.ot2.trigger", {"motion.ot1": 1}) is None


def test_leaves_rebuild_the_event(event: Event) -> None:
    value = body(event)
    for path, leaf in leaves(value):
        assert get(value, path) == leaf
