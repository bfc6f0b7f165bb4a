"""Compile means it runs (METHOD 2.2): one predicate for compiler and session."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import pytest

from ssp_core.run_spec import RunSpec, WantedPassing
from ssp_core.vocab import Phase, Verdict
from ssp_scenario_manager.compile.compiler import load_ground
from ssp_scenario_manager.compile.fitting_trigger import fitting_trigger
from ssp_scenario_manager.compile.ground import Ground
from ssp_scenario_manager.compile.realise import realise
from ssp_scenario_manager.in_process.event_check import why_not
from ssp_scenario_manager.in_process.outcome import run_in_process
from ssp_scenario_manager.interactions.base import CannotPlace
from ssp_scenario_manager.spec.load import load_event
from ssp_scenario_manager.spec.model import Event

SITES = ("boulevard", "north_track", "south_loop")
_OTHER_SIDE = {"left": "right", "right": "left"}


@cache
def shipped(name: str) -> dict[str, Any]:
    """A shipped event as a mapping; reading one takes a while."""
    event = load_event(name)[0]
    return event.model_dump(mode="json", by_alias=True, exclude={"uncertainty"})


def mirrored(value: Any) -> Any:
    """A K* with left and right exchanged in all that says where the OTs are and how they move."""
    if isinstance(value, dict):
        return {key: mirrored(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [mirrored(inner) for inner in value]
    if isinstance(value, str):
        return re.sub("left|right", lambda found: _OTHER_SIDE[found.group()], value)
    return value


def from_the_other_side(name: str) -> Event:
    """A shipped event whose OTs come from the other side; the road stays as it is."""
    value = dict(shipped(name))
    for part in ("participants", "motion", "interaction"):
        value[part] = mirrored(value[part])
    return Event.model_validate(value)


@cache
def ground_of(site: str) -> Ground:
    return load_ground(site, None)[0]


def compiled(event: Event, ground: Ground, block: int = 0) -> RunSpec:
    place = ground.library.blocks[block]
    made = realise(event, "sha256:test", place, ground, "sumo", seed=1, preferred={})
    return made.run.model_copy(update={"camera": None})


@pytest.mark.parametrize("site", SITES)
def test_a_crossing_from_the_left_is_refused_where_the_vut_would_be_there_first(site: str) -> None:
    with pytest.raises(CannotPlace) as caught:
        compiled(from_the_other_side("vru_crossing"), ground_of(site))
    said = re.search(
        r"ot1 takes ([\d.]+) s to the VUT's corridor, the VUT at its approach speed ([\d.]+) s",
        str(caught.value),
    )
    assert said is not None, str(caught.value)
    assert float(said[1]) > float(said[2])


def test_a_trigger_that_alone_is_wrong_is_told_with_a_value_that_would_do() -> None:
    event, ground = from_the_other_side("vru_crossing"), ground_of("south_loop")
    told = fitting_trigger(event, lambda other: compiled(other, ground))
    assert told is not None
    said = re.search(r"trigger\.below of ([\d.]+) s would do, K\* has 3 to 3\.4", told)
    assert said is not None, told
    value = event.model_dump(mode="json", by_alias=True)
    below = {"min": float(said[1]), "max": float(said[1]), "unit": "s"}
    value["constraints"]["trigger"]["below"] = below
    run = compiled(Event.model_validate(value), ground)
    assert run_in_process(run)[0].verdict is Verdict.VALID


def test_no_trigger_is_told_where_something_else_is_wrong() -> None:
    """Behind two oncoming lanes a trigger early enough needs a gap at the start beyond K*'s."""
    event, ground = from_the_other_side("vru_crossing"), ground_of("boulevard")
    assert fitting_trigger(event, lambda other: compiled(other, ground)) is None


# -- the predicate on runs that were changed -------------------------------------------------------


@pytest.fixture
def crossing() -> RunSpec:
    """The shipped crossing on the boulevard."""
    return compiled(Event.model_validate(shipped("vru_crossing")), ground_of("boulevard"))


def with_trigger(run: RunSpec, **changes: Any) -> RunSpec:
    trigger = run.triggers[0].model_copy(update=changes)
    return run.model_copy(update={"triggers": [trigger]})


def test_what_happens_has_no_reason_against_it(crossing: RunSpec) -> None:
    assert why_not(crossing) == []


def test_a_trigger_that_never_fires_is_said(crossing: RunSpec) -> None:
    (reason,) = why_not(with_trigger(crossing, not_before_s=39.0))
    assert "trigger of ot1 doesn't fire" in reason


def test_an_object_that_stays_beside_the_corridor_is_no_event(
    crossing: RunSpec,
) -> None:
    """It walks towards the VUT's path, so that a conflict is predicted, and stops before it."""
    run = crossing
    path = run.triggers[0].manoeuvre.motion.path  # type: ignore[union-attr]
    motion = run.triggers[0].manoeuvre.motion.model_copy(  # type: ignore[union-attr]
        update={"path": [path[0], (path[0][0], path[0][1] + 0.9)]}
    )
    manoeuvre = run.triggers[0].manoeuvre.model_copy(update={"motion": motion})
    short = with_trigger(run, manoeuvre=manoeuvre, adaptation=None)
    result, _ = run_in_process(short)
    assert result.phase_s(Phase.CONFLICT) is not None
    (reason,) = why_not(short)
    assert "ot1 doesn't come into the VUT's corridor (smallest distance" in reason


def test_a_time_gap_outside_of_k_star_is_said_with_value_and_range(
    crossing: RunSpec,
) -> None:
    wanted = WantedPassing(first="initiator", least_gap_s=3.0, most_gap_s=4.0)
    (reason,) = why_not(crossing.model_copy(update={"passing": wanted}))
    assert re.search(r"time gap .*: 1\.\d\d\d s, K\* wants 3 to 4 s, with the SIL's driver", reason)


def test_the_wrong_order_is_said(crossing: RunSpec) -> None:
    wanted = WantedPassing(first="vut", least_gap_s=0.0, most_gap_s=9.0)
    (reason,) = why_not(crossing.model_copy(update={"passing": wanted}))
    assert "ot1 reaches the conflict point first, against K*'s passing order" in reason


def test_a_refused_reference_is_said_as_the_session_says_it(
    crossing: RunSpec,
) -> None:
    limits = crossing.limits.model_copy(update={"speed_mps": 11.0, "acceleration_mps2": 1.0})
    (reason, *_) = why_not(crossing.model_copy(update={"limits": limits}))
    assert reason.startswith(("reference_refused: ot1", "over_acceleration"))
