"""Stamps of a camera that leap take the time of receipt; those of a slow simulator don't."""

from __future__ import annotations

import numpy as np
import pytest

from ssp_core.bag.pictures.stamps import settle_stamps

N = 60
LOG_S = np.arange(N) / 20
EPOCH_S = 1.7e9


def settled(stamps_s: np.ndarray, log_s: np.ndarray = LOG_S) -> tuple[np.ndarray, int]:
    """Times in s since the first one, and how many stamps leapt."""
    stamps_ns, log_ns = (
        np.round((EPOCH_S + one) * 1e9).astype(np.int64) for one in (stamps_s, log_s)
    )
    found = settle_stamps(stamps_ns, log_ns)
    return (found.times_ns - found.times_ns[0]) / 1e9, found.count


number = np.arange(N)
LEAPING = {
    "ahead, but for two frames a second": (np.where(number % 20 >= 2, 4.361, 0.0), 6),
    "one an hour ahead": (np.where(number == 30, 3600.0, 0.0), 1),
    "the device's time at first": (np.where(number < 5, -1.69e9, 0.0), 5),
    "set forward for good": (np.where(number >= 40, 7.0, 0.0), 20),
    "set back for good": (np.where(number < 20, 0.0, -1.2), 20),
    "none for some": (np.where(number % 7 == 3, -EPOCH_S, 0.0), 9),
    "a second by turns": (np.where(number % 3 == 0, 1.01, 0.0), 20),
}


@pytest.mark.parametrize("name", LEAPING)
def test_a_stamp_that_leaps_takes_the_time_of_receipt(name: str) -> None:
    off_s, count = LEAPING[name]
    times_s, leapt = settled(LOG_S + 0.01 + off_s)
    assert times_s == pytest.approx(LOG_S, abs=1e-3)
    assert leapt == count


def test_stamps_that_go_on_are_kept() -> None:
    rng = np.random.default_rng(1)
    for seed in range(30):
        rate = rng.uniform(0.05, 3.0)  # of a simulator's time
        delay_s = rng.uniform(0, 0.9, N)
        log_s = LOG_S / rate + np.where(number > 25 + seed, rng.uniform(0, 60), 0)  # paused
        received_s = np.maximum.accumulate(log_s + delay_s)
        for stamps_s in (LOG_S, LOG_S - 1.6e9, LOG_S + 37.0):
            times_s, leapt = settled(stamps_s, received_s)
            assert leapt == 0
            assert times_s == pytest.approx(LOG_S, abs=1e-6)


def test_no_frames_and_stamps_without_any_order() -> None:
    assert settle_stamps([], []).count == 0
    chaos = settle_stamps(np.arange(5000) ** 7 % 977 * 10**10, np.arange(5000) * 10**8)
    assert chaos.count > 4900
