"""The perfect control is read as it was meant: whatever it says of a label comes back."""

from __future__ import annotations

from itertools import cycle, permutations, product

import pytest
from label_conventions import contradicts

from ssp_eval.data.records import VOCABULARIES
from ssp_eval.extract import extract
from ssp_vla_bridge.backends.phrases import action_sentence, scene_text

ACTIONS = list(product(VOCABULARIES["lon_action"], VOCABULARIES["lat_action"]))
CLASSES = VOCABULARIES["objects"]


def read(text: str) -> dict[str, object]:
    """Return the values that the rules extract from a text, by slot."""
    slots = extract(text)
    found = {name: getattr(slots, name) for name in VOCABULARIES}
    return {name: None if slot is None else slot.value for name, slot in found.items()}


@pytest.mark.parametrize("critical", CLASSES)
def test_every_label_of_one_road_user_comes_back(critical: str) -> None:
    actions = cycle(ACTIONS)
    places, motions = (*VOCABULARIES["position"], None), (*VOCABULARIES["motion"], None)
    for position, motion, conflict in product(places, motions, (*VOCABULARIES["conflict"], None)):
        if contradicts(critical, motion):
            continue
        lon_action, lat_action = next(actions)
        text = scene_text((critical,), position, motion, conflict)
        assert read(f"{text} {action_sentence(lon_action, lat_action)}") == {
            "objects": (critical,),
            "position": position,
            "motion": motion,
            "conflict": conflict,
            "lon_action": lon_action,
            "lat_action": lat_action,
        }, text


def test_every_pair_of_road_users_comes_back() -> None:
    actions, conflicts = cycle(ACTIONS), cycle(VOCABULARIES["conflict"])
    motions = cycle(VOCABULARIES["motion"])
    for pair, position in product(permutations(CLASSES, 2), VOCABULARIES["position"]):
        lon_action, lat_action = next(actions)
        motion, conflict = next(motions), next(conflicts)
        if contradicts(pair[0], motion):
            continue
        text = scene_text(pair, position, motion, conflict)
        assert read(f"{text} {action_sentence(lon_action, lat_action)}") == {
            "objects": tuple(sorted(pair)),
            "position": position,
            "motion": motion,
            "conflict": conflict,
            "lon_action": lon_action,
            "lat_action": lat_action,
        }, text


def test_nobody_comes_back() -> None:
    for (lon_action, lat_action), conflict in product(ACTIONS, ("no_conflict", None)):
        text = scene_text((), None, None, conflict)
        assert read(f"{text} {action_sentence(lon_action, lat_action)}") == {
            "objects": (),
            "position": None,
            "motion": None,
            "conflict": conflict,
            "lon_action": lon_action,
            "lat_action": lat_action,
        }, text
