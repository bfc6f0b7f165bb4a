"""A series of states in arrays says the same as a list of objects, in a fifth of the memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import pytest

from ssp_core.motion.corridor import Corridor
from ssp_core.motion.event import find_event, instants_of
from ssp_core.motion.passing import passing_of
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed, StateSeries, between, states_of, times_of
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.vocabulary import ControlState
from tests.support.states import object_state


def drive(count: int) -> list[tuple[float, list[ObjectState]]]:
    """A VUT at 10 m/s, and a car ahead that comes into its lane; it is away at every 7th time."""
    rows = []
    for k in range(count):
        t_s = 0.02 * k
        vut = object_state("vut", x_m=10.0 * t_s, speed_mps=10.0, stamp_ns=20_000_000 * k)
        car = object_state(
            "ot1",
            x_m=25.0 + 8.0 * t_s,
            y_m=max(0.0, 4.0 - t_s),
            yaw_rad=-0.12,
            speed_mps=8.0,
            stamp_ns=20_000_000 * k,
            sequence=k + 1,
            control_state=ControlState.RUNNING,
        )
        rows.append((t_s, [vut] if k % 7 == 3 else [vut, car]))
    return rows


ROWS = drive(400)
AS_DICTS = [(t_s, {state.object_id: state for state in states}) for t_s, states in ROWS]
SERIES = StateSeries(ROWS)


def test_rows_are_what_was_put_in() -> None:
    assert SERIES == AS_DICTS
    assert (len(SERIES), SERIES[5], SERIES[-1]) == (400, AS_DICTS[5], AS_DICTS[-1])
    assert list(times_of(SERIES)) == [t_s for t_s, _ in ROWS]
    assert states_of(SERIES, "ot1") == [now["ot1"] for _, now in AS_DICTS if "ot1" in now]
    with pytest.raises(IndexError):
        SERIES[400]


def test_a_part_is_that_part() -> None:
    part = SERIES[100:200]
    assert part == AS_DICTS[100:200]
    assert part[10:20] == AS_DICTS[110:120]
    assert list(times_of(part)) == [t_s for t_s, _ in ROWS[100:200]]
    for first_s, last_s in ((1.0, 2.0), (-1.0, 0.5), (7.5, 99.0), (3.0, 1.0), (1.001, 1.019)):
        inside = [row for row in AS_DICTS if first_s <= row[0] <= last_s]
        assert between(SERIES, first_s, last_s) == inside
        assert between(AS_DICTS, first_s, last_s) == inside


def test_numbers_that_no_array_holds_are_kept() -> None:
    odd = [replace(ROWS[0][1][0], sequence=number) for number in (2**63 - 1, 2**63, 2**64 - 1, 1)]
    assert Packed(ObjectState, odd) == odd


def test_of_one_id_the_last_state_of_a_time_counts() -> None:
    first, second = ROWS[0][1][0], replace(ROWS[0][1][0], x_m=7.0)
    assert StateSeries([(0.0, [first, second])])[0] == (0.0, {"vut": second})


def test_the_event_is_the_same() -> None:
    lazy, plain = instants_of(SERIES, "vut", "ot1"), instants_of(AS_DICTS, "vut", "ot1")
    assert list(lazy) == plain
    assert (lazy[7], lazy[-1], lazy[3:5]) == (plain[7], plain[-1], plain[3:5])
    corridor = Corridor.of(states_of(SERIES, "vut"))
    listed = Corridor.of([now["vut"] for _, now in AS_DICTS])
    assert (corridor.path.points == listed.path.points).all()
    found = [find_event(i, corridor.path, ConflictThresholds()) for i in (lazy, plain)]
    assert found[0] is not None
    assert found[0] == found[1]
    assert passing_of(lazy, corridor, found[0]) == passing_of(plain, corridor, found[1])


def test_a_long_series_takes_little_memory() -> None:
    tracemalloc.start()
    series = StateSeries((t_s, states) for t_s, states in drive(3000))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(series) == 3000
    assert held < 3000 * 2 * 200  # objects alone take 700 bytes each
