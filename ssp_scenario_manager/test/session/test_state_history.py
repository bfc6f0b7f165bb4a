"""States judged by those before them: the fence between two places that are both inside."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_scenario_manager.session.limits import violations
from ssp_scenario_manager.session.state_history import StateHistory

MS = 1_000_000
StateMaker = Callable[..., ObjectState]
# A square with a wall that comes from its far side and ends 1 m beyond its middle.
WALL = [(100.0, 0.01), (-1.0, 0.01), (-1.0, 0.0), (100.0, 0.0)]
SQUARE = [(100.0, 100.0), (-100.0, 100.0), (-100.0, -100.0), (100.0, -100.0)]
ALONG_X = [*SQUARE, *WALL[::-1]]
ALONG_Y = [(y_m, x_m) for x_m, y_m in ALONG_X]


@pytest.mark.parametrize(
    ("fence", "before", "after"),
    [
        (ALONG_X, (0.0, -40.0), (0.0, 40.0)),
        (ALONG_X, (0.0, 40.0), (0.0, -40.0)),
        (ALONG_Y, (-40.0, 0.0), (40.0, 0.0)),
        (ALONG_Y, (40.0, 0.0), (-40.0, 0.0)),
    ],
)
def test_a_wall_that_lies_far_from_both_places_is_found_between_them(
    run: RunSpec,
    state: StateMaker,
    fence: list[tuple[float, float]],
    before: tuple[float, float],
    after: tuple[float, float],
) -> None:
    for outline, codes in ((fence, [SafetyCode.OUTSIDE_GEOFENCE]), (SQUARE, [])):
        history = StateHistory(run.model_copy(update={"geofence": outline}))
        for stamp_ns, (x_m, y_m) in ((0, before), (20 * MS, after)):
            history.see(state(stamp_ns=stamp_ns, x_m=x_m, y_m=y_m), started=True)
        assert history.has_breaks is bool(codes)
        assert [(v.code, v.object_id) for v in history.take_breaks()] == [
            (code, "vut") for code in codes
        ]


@pytest.mark.parametrize("excess_m", [0.5, 2.0])
def test_a_state_that_is_outside_itself_is_no_break_with_the_one_before(
    run: RunSpec, state: StateMaker, excess_m: float
) -> None:
    """Reported once, as a limit of that state."""
    history = StateHistory(run)
    rear_m = state().size.rear_m
    history.see(state(x_m=-9.0), started=True)
    outside = state(stamp_ns=20 * MS, x_m=-10.0 - excess_m + rear_m)
    history.see(outside, started=True)
    assert history.take_breaks() == []
    (one,) = violations([outside], run, history.is_well_inside)
    assert one.code is SafetyCode.OUTSIDE_GEOFENCE
    assert one.measured == pytest.approx(excess_m)
