"""The newest states of an object: what is remembered, and the windows that are cut from it."""

from __future__ import annotations

import math

import pytest

from ssp_core.safety.samples import SIGMAS, MotionSamples

S = 1_000_000_000


def sampled(
    *rows: tuple[float, float, float, float, float],
    std_m: float = 0.0,
    pause_s: float = 0.5,
    at_s: float = 100.0,
) -> MotionSamples:
    """Samples of time, x, y, yaw and speed; no place counts as less certain than 0.5 m."""
    samples = MotionSamples(0.5, pause_s)
    for t_s, x_m, y_m, yaw_rad, speed_mps in rows:
        samples.append(round((at_s + t_s) * S), x_m, y_m, yaw_rad, speed_mps, std_m)
    return samples


def driven(count: int, period_s: float = 0.125) -> MotionSamples:
    """A drive from (3, -2) on at 2 m/s along x and 1 m/s along y; states its x as a speed."""
    rows = [(t, 3.0 + 2.0 * t, t - 2.0, 0.5, 2.0) for t in (k * period_s for k in range(count))]
    return sampled(*rows)


def test_times_count_from_the_first_sample_and_lag_behind_the_newest() -> None:
    samples = MotionSamples(0.5, 0.5)
    assert samples.lag_s(5 * S) == -math.inf
    assert not samples.append(5 * S, 0.0, 0.0, 0.0, 0.0, 0.0)
    samples = driven(3)
    assert samples.t_s == [0.0, 0.125, 0.25]
    assert samples.lag_s(100 * S) == 0.25
    assert samples.lag_s(101 * S) == -0.75


def test_speed_and_yaw_are_integrated_by_the_mean_of_neighbours() -> None:
    samples = sampled((0.0, 0.0, 0.0, 0.5, 2.0), (0.25, 1.0, 0.0, 1.0, 4.0))
    assert samples.rows[0][6:] == (0.0, 0.0)
    assert samples.rows[1][6:] == (0.75, 0.1875)
    samples.append(round(100.5 * S), 0.0, 0.0, 1.0, 4.0, 0.0)
    assert samples.rows[2][6:] == (1.75, 0.4375)


def test_a_yaw_goes_on_without_jumps() -> None:
    samples = sampled(*((0.1 * k, 0.0, 0.0, yaw, 0.0) for k, yaw in enumerate((3.0, -3.0, 3.0))))
    yaws = [row.yaw_rad for row in samples.rows]
    assert yaws == pytest.approx([3.0, math.tau - 3.0, 3.0])


@pytest.mark.parametrize(
    ("std_m", "counts_m"), [(0.25, 0.25), (0.5, 0.5), (0.75, 0.5), (math.inf, 0.5), (math.nan, 0.5)]
)
def test_no_place_counts_as_less_certain_than_the_bound(std_m: float, counts_m: float) -> None:
    samples = sampled((0.0, 0.0, 0.0, 0.0, 0.0), std_m=std_m)
    assert samples.position_std_m == counts_m
    samples.append(101 * S, 0.0, 0.0, 0.0, 0.0, 0.125)
    assert samples.position_std_m == 0.125
    # The less certain end counts.
    assert samples.noise_m(0) == SIGMAS * counts_m
    samples.append(102 * S, 0.0, 0.0, 0.0, 0.0, 0.25)
    assert samples.noise_m(1) == SIGMAS * 0.25
    assert MotionSamples(0.5, 0.5).position_std_m == 0.0


def test_windows_begin_anew_after_a_pause() -> None:
    samples = driven(9)
    assert samples.window_start() == 4
    assert not samples.append(round((101.0 + 0.5) * S), 0.0, 0.0, 0.0, 0.0, 0.0)
    assert samples.append(round((101.5 + 0.501) * S), 0.0, 0.0, 0.0, 0.0, 0.0)
    assert (samples.speed_from, samples.way_from) == (10, 10)
    assert samples.window_start() is None
    for k in range(1, 5):
        assert not samples.append(round((102.001 + k / 8) * S), 0.0, 0.0, 0.0, 0.0, 0.0)
        assert (samples.window_start() is None) is (k < 4)
    assert samples.window_start() == 10
    # Nor does a shifted one reach back behind it.
    assert samples.shifted(10, 0.05) is None
    assert samples.shifted(10, 0.0) is not None


@pytest.mark.parametrize(
    ("count", "period_s", "first"),
    [
        (4, 0.125, None),
        (5, 0.125, 0),
        (6, 0.125, 1),
        (2, 0.5, None),
        (3, 0.5, 0),
        (4, 0.5, 1),
        (3, 0.25, 0),
        (3, 0.24, None),
        (51, 0.01, 0),
        (61, 0.01, 10),
    ],
)
def test_a_window_lasts_half_a_second_or_until_it_holds_three_samples(
    count: int, period_s: float, first: int | None
) -> None:
    samples = driven(count, period_s)
    assert samples.window_start() == first
    assert samples.window_start() == first


def test_a_window_gives_means_over_its_span() -> None:
    samples = sampled(
        (0.0, 1.0, 5.0, 0.0, 0.0),
        (0.5, 2.0, 3.0, 0.5, 2.0),
        (1.0, 5.0, -3.0, 1.5, 4.0),
    )
    whole, later = samples.window(0), samples.window(1)
    assert (whole.span_s, whole.vx_mps, whole.vy_mps) == (1.0, 4.0, -8.0)
    assert (whole.speed_mps, whole.yaw_rad) == (2.0, 0.625)
    assert (later.span_s, later.vx_mps, later.vy_mps) == (0.5, 6.0, -12.0)
    assert (later.speed_mps, later.yaw_rad) == (3.0, 1.0)


def curved() -> MotionSamples:
    """Places, speed and yaw that grow each by its own law, so that none stands for another."""
    return sampled(
        *((t, t**2, 3.0 - t**3, 0.1 * t, 1.0 + t) for t in (k * 0.125 for k in range(17)))
    )


def test_a_shifted_window_takes_motion_or_places_that_are_so_much_older() -> None:
    samples = curved()
    now, old = samples.window(12), samples.rows
    motion_is_older, places_are_older = samples.shifted(12, 0.25), samples.shifted(12, -0.25)
    assert motion_is_older is not None
    assert places_are_older is not None
    for one in (motion_is_older, places_are_older):
        assert one.span_s == 0.5
    assert (motion_is_older.vx_mps, motion_is_older.vy_mps) == (now.vx_mps, now.vy_mps)
    assert motion_is_older.speed_mps == pytest.approx((old[14].way_m - old[10].way_m) / 0.5)
    assert motion_is_older.yaw_rad == pytest.approx((old[14].turn_rads - old[10].turn_rads) / 0.5)
    assert (places_are_older.speed_mps, places_are_older.yaw_rad) == (now.speed_mps, now.yaw_rad)
    assert places_are_older.vx_mps == pytest.approx((old[14].x_m - old[10].x_m) / 0.5)
    assert places_are_older.vy_mps == pytest.approx((old[14].y_m - old[10].y_m) / 0.5)


def test_between_two_samples_a_shifted_window_is_interpolated() -> None:
    samples = driven(17)
    for delay_s in (0.05, -0.05, 0.3, 1.4):
        one = samples.shifted(12, delay_s)
        assert one is not None
        assert (one.vx_mps, one.vy_mps) == pytest.approx((2.0, 1.0))
        assert (one.speed_mps, one.yaw_rad) == pytest.approx((2.0, 0.5))
    assert samples.shifted(12, 1.5) is not None
    assert samples.shifted(12, 1.51) is None
    assert samples.shifted(12, -1.51) is None
    half = curved().shifted(12, 0.0625)
    rows = curved().rows
    assert half is not None
    way_m = 0.5 * (rows[16].way_m + rows[15].way_m - rows[12].way_m - rows[11].way_m)
    assert half.speed_mps == pytest.approx(way_m / 0.5)
    first = curved().shifted(4, 0.4375)  # from the middle of the first two samples on
    assert first is not None
    way_m = 0.5 * (rows[12].way_m + rows[13].way_m - rows[0].way_m - rows[1].way_m)
    assert first.speed_mps == pytest.approx(way_m / 1.5)


def test_figures_of_neighbours_and_of_the_newest_place() -> None:
    samples = sampled(
        (0.0, 1.0, 5.0, 0.0, -9.0),
        (0.5, 2.0, 3.0, 0.5, -2.0),
        (1.5, 5.0, -1.0, 1.5, 1.0),
        pause_s=9.0,
    )
    assert samples.step(1) == (0.5, 1.0, -2.0)
    assert samples.step(2) == (1.0, 3.0, -4.0)
    assert samples.chord_m(1) == 5.0
    assert samples.chord_m(2) == 0.0
    assert [samples.fastest_mps(since) for since in (0.0, 0.1, 0.5, 0.6)] == [9.0, 2.0, 2.0, 1.0]


def test_the_net_way_is_the_chord_of_the_last_seconds_as_far_as_states_reach() -> None:
    assert MotionSamples(0.5, 0.5).net_way_m(1.0) == (0.0, 0.0)
    samples = driven(5)
    assert samples.net_way_m(0.25) == pytest.approx((0.25 * math.sqrt(5.0), 0.25))
    assert samples.net_way_m(9.0) == pytest.approx((0.5 * math.sqrt(5.0), 0.5))
    # Between two samples the older one counts, and no more than was asked for is covered.
    assert samples.net_way_m(0.3) == pytest.approx((0.375 * math.sqrt(5.0), 0.3))
    assert driven(1).net_way_m(1.0) == (0.0, 0.0)


def test_old_samples_are_forgotten_and_windows_stay_where_they_were() -> None:
    samples = driven(0)
    longest, windows = 0, []
    for k in range(400):
        t = 0.0625 * k
        samples.append(round((7.0 + t) * S), 2.0 * t, t, 0.5, 2.0, 0.0)
        longest = max(longest, len(samples.rows))
        assert len(samples.t_s) == len(samples.rows)
        start = samples.window_start()
        if start is not None:
            windows.append(samples.window(start).span_s)
        if k > 60:
            assert samples.shifted(start or 0, 0.3) is not None
            assert samples.t_s[-1] - samples.t_s[0] > 3.0
    assert longest < 110
    assert windows == [0.5] * (400 - 8)
    # Numbers of samples that were forgotten are those of the oldest one.
    samples.restart(5)
    for k in range(400, 480):
        samples.append(round((7.0 + 0.0625 * k) * S), 0.0, 0.0, 0.0, 0.0, 0.0)
    assert (samples.speed_from, samples.way_from) == (0, 0)
    assert samples.shifted(10, 10 * 0.0625) is not None
