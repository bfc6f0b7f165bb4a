"""Bodies of a live run: what their processes said of them, or that these are silent."""

from __future__ import annotations

import pytest

from ssp_core.safety.body_status import BodyStatus, known_bodies

S = 1_000_000_000
TOLD = BodyStatus("ot1", ("deaf",), ("deaf", "no power"), lasting=True)


@pytest.mark.parametrize(("silent_s", "is_known"), [(0.0, True), (2.0, True), (2.125, False)])
def test_what_a_process_said_counts_for_two_seconds(silent_s: float, is_known: bool) -> None:
    found = known_bodies(
        ["ot1"], {"ot1": (TOLD, 7 * S), "ot9": (TOLD, 7 * S)}, round((7 + silent_s) * S)
    )
    silent = BodyStatus("ot1", ("its object_target has said nothing for 2 s",))
    assert found == {"ot1": TOLD if is_known else silent}


def test_a_process_that_was_never_heard_is_said_of_each_of_its_objects() -> None:
    never = "its object_target was never heard: it doesn't run, or can't be reached"
    assert known_bodies(["ot1", "ot2"], {"ot1": (TOLD, S)}, S) == {
        "ot1": TOLD,
        "ot2": BodyStatus("ot2", (never,)),
    }
