"""docs/event-specification.md shows what the code does: checks, units, examples and picture."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from ssp_scenario_manager.checks.check import PREDICATES
from ssp_scenario_manager.event_spec.fields import UNITS
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.picture import picture
from ssp_scenario_manager.maps.site import find_shipped

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = (DOCS / "event-specification.md").read_text()
EXAMPLES = re.findall(r"```yaml\n(.*?)```", TEXT, re.S)


def test_every_check_is_named() -> None:
    named = re.findall(r"^\| (C\d|review) \|", TEXT, re.M)
    assert named == list(PREDICATES)


def test_every_unit_is_named() -> None:
    for name in UNITS:
        assert f"`{name}`" in TEXT


def test_there_is_an_example_of_each_part() -> None:
    parts = [next(iter(yaml.safe_load(example))) for example in EXAMPLES]
    assert parts == [
        "topology",
        "participants",
        "motion",
        "interaction",
        "events",
        "constraints",
        "uncertainty",
    ]


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_are_whole_parts_of_a_shipped_event(example: str) -> None:
    shipped = yaml.safe_load(find_shipped("cut_in", "event").read_text())
    ((name, part),) = yaml.safe_load(example).items()
    if name == "uncertainty":
        assert part.items() <= shipped[name].items()
    else:
        assert part == shipped[name]


def test_the_picture_is_that_of_the_shipped_event() -> None:
    shown = (DOCS / "images" / "cut_in.svg").read_text()
    assert shown == picture(load_event("cut_in")[0]), "run `ssp spec graph cut_in --out` on it"
