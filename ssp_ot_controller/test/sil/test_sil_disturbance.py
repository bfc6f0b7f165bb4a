"""Disturbances repeat exactly for a seed, and are as large as they are said to be."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Fault, LinkDisturbance, RunSpec
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.sil.disturbance import Actuator, Channel
from tests.support.states import object_state

STEP_NS = 20_000_000
NOISY = LinkDisturbance(
    position_noise_m=0.05, speed_noise_mps=0.02, state_loss=0.1, state_delay_s=0.06
)


NONE = LinkDisturbance()


def make_run(disturbance: LinkDisturbance = NONE, seed: int = 1, *faults: Fault) -> RunSpec:
    """Nothing of a run but what a channel looks at."""
    return RunSpec.model_construct(
        disturbance=disturbance, disturbances={}, faults=list(faults), seed=seed, step_s=0.02
    )


def truth(k: int, speed_mps: float = 10.0) -> ObjectState:
    return object_state(
        x_m=0.2 * k, y_m=3.0, yaw_rad=0.1, speed_mps=speed_mps, stamp_ns=k * STEP_NS, sequence=k
    )


def stepped(channel: Channel, n: int, work: Callable[[Channel, int], Any]) -> list[Any]:
    """Return the results of ``work`` in each of n running steps."""
    found = []
    for k in range(n):
        channel.begin(k * STEP_NS, running=True, armed=False)
        found.append(work(channel, k))
    return found


def measured(
    disturbance: LinkDisturbance, seed: int = 1, object_id: str = "ot1", n: int = 50, *f: Fault
) -> list[ObjectState]:
    channel = Channel(make_run(disturbance, seed, *f), object_id)
    return stepped(channel, n, lambda c, k: c.measure(truth(k), k * STEP_NS))


def arrivals(
    disturbance: LinkDisturbance, seed: int = 1, object_id: str = "ot1", n: int = 200, *f: Fault
) -> list[list[int]]:
    """Numbers of the states that arrive in each step."""
    channel = Channel(make_run(disturbance, seed, *f), object_id)
    return stepped(channel, n, lambda c, k: [s.sequence for s in c.up(truth(k), k * STEP_NS)])


# -- disturbances ------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_stream() -> None:
    assert measured(NOISY) == measured(NOISY)
    assert arrivals(NOISY) == arrivals(NOISY)


def test_other_seeds_and_other_objects_have_streams_of_their_own() -> None:
    assert measured(NOISY) != measured(NOISY, 2)
    assert measured(NOISY) != measured(NOISY, 1, "ot2")
    assert arrivals(NOISY) != arrivals(NOISY, 2)
    assert arrivals(NOISY) != arrivals(NOISY, 1, "ot2")


ALL = {
    "state_delay_s": 0.04,
    "state_jitter_s": 0.03,
    "reorder": 0.3,
    "command_delay_s": 0.04,
    "command_loss": 0.3,
    "clock_offset_s": 0.1,
    "dropout_per_s": 2.0,
    "actuator_lag_scale": 1.3,
}


@settings(max_examples=20, deadline=None)
@given(st.sets(st.sampled_from(sorted(ALL))))
def test_one_disturbance_more_leaves_the_noise_of_the_others(names: set[str]) -> None:
    alone = measured(LinkDisturbance(position_noise_m=0.05))
    with_others = measured(
        LinkDisturbance(position_noise_m=0.05, **{name: ALL[name] for name in names})
    )
    for a, b in zip(alone, with_others, strict=True):
        held = "dropout_per_s" in names and b.x_m != a.x_m
        assert held or (a.x_m, a.y_m) == (b.x_m, b.y_m)


def test_a_link_fault_later_leaves_the_losses_before_and_after_it() -> None:
    fault = Fault(kind="link_cut", target="ot1", at_s=1.0, duration_s=0.5)
    plain = arrivals(LinkDisturbance(state_loss=0.2))
    cut = arrivals(LinkDisturbance(state_loss=0.2), 1, "ot1", 200, fault)
    assert plain[:50] == cut[:50]
    assert cut[50:75] == [[]] * 25
    assert plain[75:] == cut[75:]


def test_streams_do_not_depend_on_the_sizes_of_the_disturbances() -> None:
    """A run with less noise is the same run with less noise."""
    small = measured(LinkDisturbance(position_noise_m=0.025), 3)
    large = measured(NOISY, 3)
    for k, (a, b) in enumerate(zip(small, large, strict=True)):
        assert (a.x_m - 0.2 * k) * 2 == pytest.approx(b.x_m - 0.2 * k)


def test_without_disturbance_everything_passes_as_it_is() -> None:
    channel = Channel(make_run(), "ot1")
    channel.begin(0, running=True, armed=False)
    assert channel.measure(truth(3), 0) is not None
    assert channel.measure(truth(3), 0) == truth(3)
    assert channel.up(truth(3), 0) == [truth(3)]
    assert channel.up_acks(["a", "b"], 0) == ["a", "b"]
    assert channel.down_heartbeats([1], 0) == [1]
    assert channel.down_references([2], 0) == [2]
    assert channel.clock_ns(7) == 7


def test_while_the_world_holds_nothing_is_disturbed_and_nothing_is_drawn() -> None:
    channel = Channel(make_run(NOISY), "ot1")
    for _ in range(7):
        channel.begin(0, running=False, armed=True)
        assert channel.measure(truth(0), 0) == truth(0)
        assert channel.up(truth(0), 0) == [truth(0)]
        assert channel.down_heartbeats([1], 0) == [1]
    later = stepped(channel, 50, lambda c, k: c.measure(truth(k), k * STEP_NS))
    assert later == measured(NOISY)


def test_noise_has_the_size_that_is_said_and_stated() -> None:
    states = measured(NOISY, 7, n=4000)
    dx = np.array([s.x_m - 0.2 * k for k, s in enumerate(states)])
    dy = np.array([s.y_m - 3.0 for s in states])
    dv = np.array([s.speed_mps - 10.0 for s in states])
    for errors, sigma in ((dx, 0.05), (dy, 0.05), (dv, 0.02)):
        assert errors.std() == pytest.approx(sigma, rel=0.06)
        assert abs(errors.mean()) < 4 * sigma / math.sqrt(len(errors))
    assert {s.position_std_m for s in states} == {0.05}
    # What isn't measured by it stays true.
    assert {(s.yaw_rad, s.acceleration_mps2, s.yaw_rate_radps) for s in states} == {(0.1, 0.0, 0.0)}


@pytest.mark.parametrize("name", ["position_noise_m", "speed_noise_mps"])
def test_each_noise_by_itself(name: str) -> None:
    state = measured(LinkDisturbance(**{name: 0.5}), n=2)[1]
    assert (state.x_m != 0.2) == (state.y_m != 3.0) == (name == "position_noise_m")
    assert (state.speed_mps != 10.0) == (name == "speed_noise_mps")


def test_who_stands_knows_it() -> None:
    channel = Channel(make_run(NOISY), "ot1")
    channel.begin(0, running=True, armed=False)
    assert channel.measure(truth(1, speed_mps=0.0), 0).speed_mps == 0.0
    assert channel.measure(truth(1, speed_mps=0.2), 0).speed_mps != 0.2


@pytest.mark.parametrize(("delay_s", "steps"), [(0.0, 0), (0.02, 1), (0.06, 3), (0.049, 2)])
def test_delay_is_exact(delay_s: float, steps: int) -> None:
    got = arrivals(LinkDisturbance(state_delay_s=delay_s), n=20)
    assert got == [[k - steps] if k >= steps else [] for k in range(20)]


def test_loss_has_its_rate_and_delays_nothing_else() -> None:
    got = arrivals(NOISY, 11, n=5000)
    lost = got[3:].count([])
    assert lost / len(got[3:]) == pytest.approx(0.1, abs=0.015)
    assert all(one in ([], [k - 3]) for k, one in enumerate(got))
    assert all(arrivals(NONE, 11, n=500))


def test_jitter_keeps_the_order_and_has_its_size() -> None:
    got = arrivals(LinkDisturbance(state_delay_s=0.1, state_jitter_s=0.02), n=4000)
    order = [one for step in got for one in step]
    assert order == list(range(len(order)))
    assert len(order) > 3980
    late = [k - one for k, step in enumerate(got) for one in step]
    # Later ones wait for earlier ones, so that the mean is above the delay's five steps.
    assert 5.0 < np.mean(late) < 7.0
    assert 0.4 < np.std(late) < 1.2
    assert min(late) >= 2


def test_overtaken_states_come_after_the_next_one_and_none_is_lost() -> None:
    got = arrivals(LinkDisturbance(reorder=0.2), n=2000)
    order = [one for step in got for one in step]
    assert sorted(order) == list(range(len(order)))
    overtaken = sum(b < a for a, b in itertools.pairwise(order))
    assert overtaken / 2000 == pytest.approx(0.2 / 1.2, abs=0.03)
    assert all(len(step) in (0, 1, 2) for step in got)


def test_commands_are_delayed_and_lost_on_their_way_down() -> None:
    channel = Channel(make_run(LinkDisturbance(command_delay_s=0.04, command_loss=0.25)), "ot1")
    beats = stepped(channel, 2000, lambda c, k: c.down_heartbeats([k], k * STEP_NS))
    assert all(one in ([], [k - 2]) for k, one in enumerate(beats))
    assert beats.count([]) / 2000 == pytest.approx(0.25, abs=0.03)
    # References have luck of their own; those of one step share it.
    channel = Channel(make_run(LinkDisturbance(command_loss=0.25)), "ot1")
    references = stepped(channel, 400, lambda c, k: c.down_references([k, -k], k * STEP_NS))
    assert all(one in ([], [k, -k]) for k, one in enumerate(references))
    assert [bool(r) for r in references] != [bool(b) for b in beats[2:402]]


def test_a_clock_that_is_off_shows_in_stamps_of_states() -> None:
    states = measured(LinkDisturbance(clock_offset_s=-0.03))
    assert [s.stamp_ns for s in states] == [k * STEP_NS - 30_000_000 for k in range(50)]
    channel = Channel(make_run(LinkDisturbance(clock_offset_s=0.2)), "ot1")
    assert channel.links().clock_offset_s == 0.2
    channel.begin(0, running=True, armed=False)
    assert channel.clock_ns(0) == 200_000_000


def test_localisation_that_drops_out_says_its_last_state_again() -> None:
    states = measured(LinkDisturbance(dropout_per_s=1.0, dropout_s=0.1), n=5000)
    ages = [k - s.stamp_ns // STEP_NS for k, s in enumerate(states)]
    assert set(ages) == {0, 1, 2, 3, 4, 5}
    begun = sum(a == 1 for a in ages)
    assert begun == pytest.approx(100 / 1.1, rel=0.3)
    for state in states:
        assert state.x_m == truth(state.stamp_ns // STEP_NS).x_m
    assert [s.sequence for s in states] == list(range(5000))


# -- faults ------------------------------------------------------------------------------------


def test_faults_begin_and_end_by_session_time_and_say_so() -> None:
    fault = Fault(kind="position_jump", target="ot1", at_s=0.1, duration_s=0.06, value=2.0)
    channel = Channel(make_run(NONE, 1, fault), "ot1")
    changes, jumped = {}, []
    for k in range(12):
        for change in channel.begin(k * STEP_NS, running=True, armed=False):
            changes[k] = change
        state = channel.measure(truth(k), k * STEP_NS)
        if (state.x_m, state.y_m) != (truth(k).x_m, truth(k).y_m):
            # To the left of its heading of 0.1 rad.
            assert state.x_m == pytest.approx(0.2 * k - 2.0 * math.sin(0.1))
            assert state.y_m == pytest.approx(3.0 + 2.0 * math.cos(0.1))
            jumped.append(k)
    assert jumped == [5, 6, 7]
    assert {k: c.active for k, c in changes.items()} == {5: True, 8: False}
    first = changes[5]
    assert (first.number, first.kind, first.target) == (0, "position_jump", "ot1")
    assert (first.value, first.unit) == (2.0, "m")


def test_a_fault_is_its_targets_alone() -> None:
    fault = Fault(kind="state_nan", target="ot2", at_s=0.0)
    assert measured(NONE, 1, "ot1", 5, fault) == [truth(k) for k in range(5)]
    assert all(not s.is_finite for s in measured(NONE, 1, "ot2", 5, fault))


def test_a_fault_without_a_time_begins_when_the_object_is_armed() -> None:
    channel = Channel(make_run(NONE, 1, Fault(kind="link_cut", target="ot1")), "ot1")
    assert channel.begin(0, running=False, armed=False) == []
    assert channel.up(truth(0), 0) == [truth(0)]
    assert [c.active for c in channel.begin(0, running=False, armed=True)] == [True]
    assert channel.up(truth(0), 0) == []
    assert channel.down_heartbeats([1], 0) == []
    assert channel.links().cut
    assert channel.begin(STEP_NS, running=True, armed=False) == []
    assert channel.up(truth(1), STEP_NS) == []


def test_a_cut_takes_what_is_under_way() -> None:
    fault = Fault(kind="link_cut", target="ot1", at_s=0.2, duration_s=0.1)
    got = arrivals(LinkDisturbance(state_delay_s=0.06), 1, "ot1", 30, fault)
    assert got[9] == [6]
    assert got[10:18] == [[]] * 8
    assert got[18] == [15]


@pytest.mark.parametrize(("delay_s", "steps"), [(0.05, 2), (0.15, 8), (0.5, 25)])
def test_link_delay_holds_both_ways(delay_s: float, steps: int) -> None:
    fault = Fault(kind="link_delay", target="ot1", at_s=0.2, value=delay_s)
    got = arrivals(NONE, 1, "ot1", 60, fault)
    assert got[:10] == [[k] for k in range(10)]
    assert got[10:] == [[k - steps] if k - steps >= 10 else [] for k in range(10, 60)]
    channel = Channel(make_run(NONE, 1, fault), "ot1")
    beats = stepped(channel, 60, lambda c, k: c.down_heartbeats([k], k * STEP_NS))
    assert beats == got
    assert channel.links().up_s == channel.links().down_s == delay_s


def test_when_a_delay_ends_what_waited_comes_at_once_and_in_order() -> None:
    fault = Fault(kind="link_delay", target="ot1", at_s=0.2, duration_s=0.1, value=0.2)
    got = arrivals(NONE, 1, "ot1", 40, fault)
    assert [one for step in got for one in step] == list(range(40))


def test_losses_of_a_fault_add_to_the_usual_ones() -> None:
    fault = Fault(kind="link_loss", target="ot1", at_s=0.0, value=0.5)
    got = arrivals(LinkDisturbance(state_loss=0.2), 1, "ot1", 4000, fault)
    assert got.count([]) / 4000 == pytest.approx(1 - 0.8 * 0.5, abs=0.025)
    channel = Channel(make_run(NONE, 1, fault), "ot1")
    acks = stepped(channel, 2000, lambda c, k: c.up_acks([k], k * STEP_NS))
    assert acks.count([]) / 2000 == pytest.approx(0.5, abs=0.04)


def test_a_stepped_clock_and_a_frozen_position() -> None:
    faults = [
        Fault(kind="clock_step", target="ot1", at_s=0.1, duration_s=0.1, value=-0.5),
        Fault(kind="state_frozen", target="ot1", at_s=0.3, duration_s=0.1),
    ]
    states = measured(LinkDisturbance(position_noise_m=0.01), 1, "ot1", 30, *faults)
    offsets = [s.stamp_ns - k * STEP_NS for k, s in enumerate(states)]
    assert offsets == [0] * 5 + [-500_000_000] * 5 + [0] * 20
    assert len({(s.x_m, s.y_m) for s in states[15:20]}) == 1
    assert len({s.x_m for s in states[:16]}) == 16
    assert [s.sequence for s in states] == list(range(30))


def test_a_stuck_actuator_heeds_an_emergency_stop_alone() -> None:
    def act(fault: Fault, commands: list[Command]) -> list[float]:
        actuator = Actuator(make_run(NONE, 1, fault), "ot1")
        return [actuator.actuate(c, k * STEP_NS).acceleration_mps2 for k, c in enumerate(commands)]

    commands = [Command(a, 0.1, 0.0) for a in (0.5, 1.0, -2.0, -3.0, -4.0)]
    held = Fault(kind="actuator_stuck", target="ot1", at_s=0.04, duration_s=0.04)
    assert act(held, commands) == [0.5, 1.0, 1.0, 1.0, -4.0]
    given = Fault(kind="actuator_stuck", target="ot1", at_s=0.04, value=2.5)
    assert act(given, commands) == [0.5, 1.0, 2.5, 2.5, 2.5]
    other = Fault(kind="actuator_stuck", target="ot2", at_s=0.0)
    assert act(other, commands) == [c.acceleration_mps2 for c in commands]
    stop = Command(0.0, 0.1, 0.0, emergency_stop=True)
    actuator = Actuator(make_run(NONE, 1, given), "ot1")
    assert actuator.actuate(stop, 1_000_000_000) == stop
