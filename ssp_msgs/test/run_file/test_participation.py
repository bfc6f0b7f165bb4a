"""Real session, simulation or stand-in: the participants' declarations decide (METHOD 4.4b)."""

from __future__ import annotations

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import (
    ParticipantKind,
    Participation,
    Standing,
    declaring,
)
from tests.support.runs import cut_in_run

RUN = RunSpec.model_validate({**cut_in_run(), "camera": {"width_px": 240, "height_px": 135}})
EVERYBODY = declaring(RUN)
ALL_REAL = dict.fromkeys(EVERYBODY, (ParticipantKind.REAL.value,))


def test_vut_positioning_camera_and_each_object_with_its_body_declare() -> None:
    assert EVERYBODY == ("vut", "vut/positioning", "vut/camera", "ot1", "ot1/body")
    without = RUN.model_copy(update={"camera": None})
    assert "vut/camera" not in declaring(without)


def test_the_run_file_lists_at_least_these() -> None:
    listed = RunSpec.model_validate(
        {**cut_in_run(), "camera": {}, "declaring": [*EVERYBODY, "gate"]}
    )
    read = RunSpec.model_validate_json(listed.model_dump_json(by_alias=True))
    assert declaring(read) == declaring(listed) == (*EVERYBODY, "gate")
    assert "declaring" not in RUN.model_dump()
    for who in EVERYBODY:
        rest = [other for other in EVERYBODY if other != who]
        with pytest.raises(ValueError, match=f"declaring lacks {who}, which must declare"):
            RunSpec.model_validate({**cut_in_run(), "camera": {}, "declaring": rest})


def test_a_session_is_real_only_if_everybody_is() -> None:
    assert Participation("live", ALL_REAL).standing is Standing.REAL


@pytest.mark.parametrize("who", EVERYBODY)
@pytest.mark.parametrize("kind", [ParticipantKind.SIMULATED, ParticipantKind.PLAYED])
def test_one_that_was_simulated_or_played_makes_a_stand_in(who: str, kind: ParticipantKind) -> None:
    found = Participation("live", {**ALL_REAL, who: (kind.value,)})
    assert found.standing is Standing.STAND_IN
    assert f"{kind}: {who}" in found.text
    # No person's word changes what a program says of itself.
    assert Participation("live", found.declared, {who: "real"}, "A").standing is Standing.STAND_IN


@pytest.mark.parametrize("who", EVERYBODY)
def test_one_that_is_silent_leaves_it_undeclared_until_a_person_speaks_for_it(who: str) -> None:
    silent = {**ALL_REAL, who: ()}
    found = Participation("live", silent)
    assert (found.standing, found.silent) == (Standing.UNDECLARED, (who,))
    spoken = Participation("live", silent, {who: "real"}, "A. Engineer, 2026-03-01, north track")
    assert spoken.standing is Standing.REAL
    assert "by the word of A. Engineer, 2026-03-01, north track" in spoken.text


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_simulated_world_is_a_stand_in_whatever_anybody_declares(mode: str) -> None:
    assert Participation(mode, ALL_REAL).standing is Standing.STAND_IN


def test_two_different_declarations_contradict_each_other() -> None:
    found = Participation("live", {**ALL_REAL, "vut": ("real", "simulated")})
    assert found.contradictions == ("vut is declared real and simulated",)
    assert found.standing is Standing.STAND_IN
    assert Participation("live", ALL_REAL).contradictions == ()
