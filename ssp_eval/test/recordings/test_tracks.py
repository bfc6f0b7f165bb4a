"""Two recordings of one drive are found whatever was done to one of them, and two drives never."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from ssp_eval.recordings.tracks import SAME_RMS_M, Track, same_drive

Tracks = Mapping[str, Track]
VUT = ("vut", "vut")


def drive(seed: int, *, hz: float = 50.0, noise_m: float = 0.02, spread: float = 1.0) -> Tracks:
    """A car that cuts in on a VUT, which brakes; driven a little differently by each seed.

    Args:
        noise_m: of each coordinate of each state.
        spread: how much the drives of two seeds differ; 0: only by that noise.
    """
    of_drive, of_states = np.random.default_rng((seed, 1)), np.random.default_rng((seed, 2))
    late_s, faster = spread * of_drive.normal(0.0, 0.05), 1.0 + spread * of_drive.normal(0.0, 0.01)
    times_s = np.arange(0.0, 14.0, 1.0 / hz)
    at_s = times_s - late_s
    braking = 1.0 - 0.25 * (1.0 + np.tanh((at_s - 7.0) / 0.8))
    along_m = np.cumsum(12.0 * faster * braking) / hz
    aside_m = 3.5 / (1.0 + np.exp(-(at_s - 6.0) / 0.5)) - 3.5
    places = {"vut": along_m + 0j, "ot1": 15.0 + 10.0 * faster * at_s + 1j * aside_m}
    return {
        who: Track(
            times_s,
            p + noise_m * (of_states.normal(size=p.shape) + 1j * of_states.normal(size=p.shape)),
        )
        for who, p in places.items()
    }


def each(tracks: Tracks, change: Callable[[Track], Track]) -> Tracks:
    return {who: change(track) for who, track in tracks.items()}


def resampled(tracks: Tracks, hz: float) -> Tracks:
    def change(track: Track) -> Track:
        times_s = np.arange(track.times_s[0] + 0.013, track.times_s[-1], 1.0 / hz)
        return Track(times_s, np.interp(times_s, track.times_s, track.places_m))

    return each(tracks, change)


def select(tracks: Tracks, choose: Callable[[Track], np.ndarray]) -> Tracks:
    def change(track: Track) -> Track:
        chosen = choose(track)
        return Track(track.times_s[chosen], track.places_m[chosen])

    return each(tracks, change)


def noisy(tracks: Tracks, noise_m: float) -> Tracks:
    rng = np.random.default_rng(9)

    def change(track: Track) -> Track:
        more = rng.normal(0.0, noise_m, (2, len(track)))
        return Track(track.times_s, track.places_m + more[0] + 1j * more[1])

    return each(tracks, change)


def moved(track: Track) -> Track:
    return Track(track.times_s, track.places_m * np.exp(1.1j) + 500.0 - 230.0j)


def departing(track: Track) -> Track:
    """Return the track with another end made up from 9 s on."""
    return Track(track.times_s, track.places_m + 0.2 * np.maximum(track.times_s - 9.0, 0.0) ** 2)


COPIES: dict[str, Callable[[Tracks], Tracks]] = {
    "as it is": lambda tracks: tracks,
    "another clock": lambda tracks: each(tracks, lambda t: Track(t.times_s + 3.217, t.places_m)),
    "turned and moved": lambda tracks: each(tracks, moved),
    "mirrored": lambda tracks: each(tracks, lambda t: Track(t.times_s, t.places_m.conj())),
    "at 5 Hz": lambda tracks: resampled(tracks, 5.0),
    "at 10 Hz, mirrored and turned": lambda tracks: each(
        resampled(tracks, 10.0), lambda t: moved(Track(t.times_s - 1.4, t.places_m.conj()))
    ),
    "its first part": lambda tracks: select(tracks, lambda t: t.times_s < 9.0),
    "its last part": lambda tracks: select(tracks, lambda t: t.times_s > 4.0),
    "states left out": lambda tracks: select(
        tracks, lambda t: np.random.default_rng(len(t)).random(len(t)) > 0.3
    ),
    "places rounded to 1 cm": lambda tracks: each(
        tracks, lambda t: Track(t.times_s, t.places_m.round(2))
    ),
    "noise of 6 mm": lambda tracks: noisy(tracks, 0.006),
    "another end": lambda tracks: each(tracks, departing),
    "another name": lambda tracks: {"vut": tracks["vut"], "car": tracks["ot1"]},
}


@pytest.mark.parametrize("copy", COPIES)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_copy_is_found_whatever_was_done_to_it(copy: str, seed: int) -> None:
    tracks = drive(seed)
    for first, second in ((tracks, COPIES[copy](tracks)), (COPIES[copy](tracks), tracks)):
        found = same_drive(first, second, VUT)
        assert found is not None
        assert found.rms_m < SAME_RMS_M
        assert found.mirrored is ("mirrored" in copy)
        assert found.length_s >= 5.0


def test_a_smooth_drive_is_found_at_every_rate() -> None:
    smooth = drive(3, noise_m=0.0)
    for hz in (5.0, 12.5, 100.0):
        assert same_drive(smooth, resampled(smooth, hz), VUT) is not None
        assert same_drive(resampled(smooth, hz), resampled(smooth, 20.0), VUT) is not None


def test_how_they_are_equal_is_said() -> None:
    tracks = drive(4)
    found = same_drive(tracks, COPIES["at 10 Hz, mirrored and turned"](tracks), VUT)
    assert found is not None
    assert "mirrored, turned by 63 degrees, shifted by -1.40 s" in found.text
    assert math.isclose(found.shift_s, -1.4, abs_tol=0.01)


def test_two_drives_of_one_plan_are_never_one() -> None:
    """Neither drives that differ, nor the same motion measured twice with noise of 2 cm."""
    for seed in range(0, 20, 2):
        for spread in (0.0, 1.0):
            first, second = drive(seed, spread=spread), drive(seed + 1, spread=spread)
            assert same_drive(first, second, VUT) is None
    first, second = drive(1, noise_m=0.0), drive(2, noise_m=0.0)
    assert same_drive(first, second, VUT) is None


def test_straight_lines_at_constant_speed_tell_nothing() -> None:
    """A VUT that stands, and an object that passes: every such recording is like every other."""
    times_s = np.arange(0.0, 12.0, 0.05)
    still = {"vut": Track(times_s, 0.0 * times_s + 0j), "ot1": Track(times_s, 8.0 * times_s + 3j)}
    assert same_drive(still, still, VUT) is None


def test_less_than_five_seconds_of_motion_tell_nothing() -> None:
    short = select(drive(5), lambda t: (t.times_s > 5.0) & (t.times_s < 9.0))
    assert same_drive(short, short, VUT) is None
    assert same_drive({}, short, VUT) is None
