"""From light to the numbers of a frame: exposure, vignette, sensor noise, rounding."""

from __future__ import annotations

import numpy as np

from ssp_ot_controller.camera.jit import Array, compiled, inlined

_VIGNETTE = 0.10  # light that the corners lose
_GRAIN_LENGTH = 1 << 17
_GRAIN_SIGMA = 104.5  # standard deviation of a sum of two uniform bytes


def make_grain() -> Array:
    """Noise to be read from changing starts, shape (n,), int16: sums of two uniform bytes - 255."""
    bytes_ = np.random.default_rng(0).integers(0, 256, (2, _GRAIN_LENGTH), dtype=np.int16)
    return np.asarray(bytes_.sum(axis=0, dtype=np.int16) - 255, dtype=np.int16)


def falloff(width_px: int) -> Array:
    """Squared distance from the middle column per channel of a row, shape (3 width,), float32."""
    columns = np.arange(width_px, dtype=np.float32) - np.float32(0.5 * (width_px - 1))
    return np.repeat(columns * columns, 3)


@inlined
def mixed(state: np.uint64) -> np.uint64:
    """A well mixed 64-bit number (splitmix64)."""
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


@inlined
def develop_row(
    row: Array,
    squares: Array,
    v: int,
    height: int,
    exposure: float,
    noise_sigma: float,
    grain: Array,
    noise_state: np.uint64,
    out: Array,
) -> None:
    """Writes one image row.

    Args:
        row: shape (3 width,), float32, light of blue, green, red in turn.
        squares: of falloff.
        v: the row's number, of ``height``.
        exposure: factor on the light.
        noise_sigma: standard deviation of the noise, of 255.
        grain: of make_grain.
        noise_state: what the noise of this frame follows from.
        out: shape (3 width,), uint8.
    """
    length = row.shape[0]
    dy = v - 0.5 * (height - 1)
    corner = _VIGNETTE / ((length / 6.0) ** 2 + (0.5 * height) ** 2)
    gain = np.float32(exposure * (1.0 - corner * dy * dy))
    loss = np.float32(exposure * corner)
    scale = np.float32(noise_sigma / _GRAIN_SIGMA)
    number = mixed(noise_state + np.uint64(v) * np.uint64(0x9E3779B97F4A7C15))
    begin = int(number % np.uint64(grain.shape[0] - length))
    part = grain[begin : begin + length]
    half, lowest, highest = np.float32(0.5), np.float32(0.0), np.float32(255.0)
    for i in range(length):
        value = (gain - loss * squares[i]) * row[i] + scale * np.float32(part[i]) + half
        out[i] = np.uint8(min(highest, max(lowest, value)))


@compiled
def develop(
    light: Array,
    squares: Array,
    exposure: float,
    noise_sigma: float,
    grain: Array,
    noise_state: np.uint64,
    out: Array,
) -> None:
    """Writes a whole image; arguments as develop_row, with ``light`` and ``out`` row by row."""
    for v in range(out.shape[0]):
        develop_row(
            light[v], squares, v, out.shape[0], exposure, noise_sigma, grain, noise_state, out[v]
        )
