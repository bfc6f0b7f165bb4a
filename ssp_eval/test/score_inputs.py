"""Any labels and any outputs, for the property tests of scoring (METHOD 5.2 to 5.4)."""

import math
from dataclasses import replace

from hypothesis import strategies as st

from ssp_core.vocabulary import (
    CONFLICTS,
    LAT_ACTIONS,
    LON_ACTIONS,
    MOTIONS,
    OBJECTS,
    PHASES,
    POSITIONS,
)
from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_vla_bridge.trajectory import Trajectory

MOVES = {
    "stop": (1.0, 1.0),
    "decelerate": (5.0, 9.0),
    "maintain": (5.0, 10.0),
    "accelerate": (5.0, 11.0),
}
SHIFTS = {"left": 0.5, "straight": 0.0, "right": -0.5}


def some(vocabulary, least=0):
    return st.lists(st.sampled_from(vocabulary), unique=True, min_size=least).map(tuple)


def rising(least=1):
    """Times on a coarse grid: windows overlap, distances tie or are exactly 0.11 s."""
    steps = st.lists(st.integers(0, 40), min_size=least, max_size=7, unique=True).map(sorted)
    return st.builds(
        lambda steps, step_s: [step * step_s for step in steps],
        steps,
        st.sampled_from([0.05, 0.055, 0.3]),
    )


labels_of_one_time = st.builds(
    Label,
    t_s=st.just(0.0),
    phase=st.sampled_from(PHASES),
    risk_visible=st.booleans(),
    objects=st.none() | some(OBJECTS),
    position=st.none() | st.sampled_from(POSITIONS),
    motion=st.none() | st.sampled_from(MOTIONS),
    conflict=st.none() | st.sampled_from(CONFLICTS),
    lon_actions=some(LON_ACTIONS, 1),
    lat_actions=some(LAT_ACTIONS, 1),
)


@st.composite
def any_labels(draw):
    items = [replace(draw(labels_of_one_time), t_s=time) for time in draw(rising())]
    seen = any(item.risk_visible for item in items)
    onset = draw(st.none() | st.floats(0, 2)) if seen else draw(st.floats(0, 2))
    return Labels("cut_in", "physical", "v", onset, draw(st.booleans()), (*items,))


places = st.integers(-2, 8) | st.sampled_from([10**30, -(10**30)])
spans = st.lists(st.tuples(places, places), max_size=2).map(tuple) | st.just(((0, 4),))


def slots_of(vocabulary):
    return st.none() | st.builds(Slot, st.sampled_from(vocabulary), spans)


numbers = st.floats(-30, 30) | st.sampled_from([math.nan, math.inf, -1e308, 1e308])
trajectories = (
    st.none()
    | st.builds(
        Trajectory,
        st.sampled_from(
            [
                (0.0, 0.5, 1.0),
                (0.0, 1.0, 2.0),
                (0.0, 0.5, 0.9),
                (-0.3, 0.7, 1.4),
                (5e-10, 0.5, 1.0 - 5e-10),
                (0.0, 1.0, 0.5),
                (0.0, math.nan, 1.0),
            ]
        ),
        st.tuples(numbers, numbers, numbers),
        st.tuples(numbers, numbers, numbers),
    )
    | st.builds(Trajectory, *[st.lists(numbers, max_size=3).map(tuple) for _ in range(3)])
    | st.sampled_from(
        [Trajectory((0.0, 0.5, 1.0), (0.0, *xs), (0.0,) * 3) for xs in MOVES.values()]
    )
)


@st.composite
def any_records(draw, least=0):
    return [
        BehaviourRecord(
            t_s=time,
            text=draw(st.sampled_from(["", " ", "a car", "slow down"])),
            slots=Slots(
                objects=draw(st.none() | st.builds(Slot, some(OBJECTS), spans)),
                position=draw(slots_of(POSITIONS)),
                motion=draw(slots_of(MOTIONS)),
                conflict=draw(slots_of(CONFLICTS)),
                lon_action=draw(slots_of(LON_ACTIONS)),
                lat_action=draw(slots_of(LAT_ACTIONS)),
            ),
            trajectory=draw(trajectories),
        )
        for time in draw(rising(least))
    ]
