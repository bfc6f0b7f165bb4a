"""Surface kinds of triangles, and the patterns that the rasteriser evaluates per sample."""

from __future__ import annotations

import math

import numpy as np

from ssp_ot_controller.camera.jit import Array, inlined

# Kinds; numba kernels need plain integers.
MATTE = 0
GLOSSY = 1  # car paint: reflects the sky on upward faces
GLASS = 2
LAMP = 3  # shines by itself, no light falls on it
FACADE = 4  # coordinates: metres along the wall and above the ground
FOLIAGE = 5  # coordinates: metres, any

NOISE_SIZE = 256  # texels per side of the tileable noise, a power of two
_WINDOW_PERIOD_U_M = 2.9
_WINDOW_PERIOD_V_M = 3.1


def make_noise(seed: int) -> Array:
    """Tileable value noise, shape (NOISE_SIZE, NOISE_SIZE), float32 with mean 0, within [-1, 1]."""
    rng = np.random.default_rng(seed)
    total = np.zeros((NOISE_SIZE, NOISE_SIZE))
    for cells, weight in ((16, 0.35), (64, 0.35), (NOISE_SIZE, 0.3)):
        coarse = rng.uniform(-1.0, 1.0, (cells, cells))
        position = np.arange(NOISE_SIZE) * cells / NOISE_SIZE
        low = position.astype(int)
        part = position - low
        part = part * part * (3.0 - 2.0 * part)
        high = (low + 1) % cells
        rows = coarse[low] * (1 - part)[:, None] + coarse[high] * part[:, None]
        total += weight * (rows[:, low] * (1 - part) + rows[:, high] * part)
    total -= total.mean()
    return np.asarray(total / np.abs(total).max(), dtype=np.float32)


@inlined
def noise_at(noise: Array, x: float, y: float) -> float:
    """Bilinear value of the tileable noise at texel coordinates, any range."""
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    mask = NOISE_SIZE - 1
    i0, j0 = int(x0) & mask, int(y0) & mask
    i1, j1 = (i0 + 1) & mask, (j0 + 1) & mask
    top = noise[j0, i0] + fx * (noise[j0, i1] - noise[j0, i0])
    low = noise[j1, i0] + fx * (noise[j1, i1] - noise[j1, i0])
    value: float = top + fy * (low - top)
    return value


@inlined
def _overlap(start: float, end: float, low: float, high: float) -> float:
    """Length that two stretches have in common."""
    common: float = max(0.0, min(end, high) - max(start, low))
    return common


@inlined
def window_mix(
    u_m: float, v_m: float, width_u_m: float, width_v_m: float, lit_share: float
) -> tuple[float, float]:
    """Share of glass and share of lit window (of 1) in a footprint on a facade.

    Windows are products of marks along and up, so that the mean over a rectangle is one too. It
    goes to the mean of the wall where the footprint no longer resolves a window. Without branches,
    so that the compiler does several places at once.
    """
    blur = min(1.0, max(0.0, (max(width_u_m, width_v_m) - 1.0) / 1.6))
    u, v = u_m * (1.0 / _WINDOW_PERIOD_U_M), v_m * (1.0 / _WINDOW_PERIOD_V_M)
    cu, cv = np.floor(u), np.floor(v)
    # No wider than what stays clear of the next window.
    wu = min(max(width_u_m * (1.0 / _WINDOW_PERIOD_U_M), 1e-3), 0.44)
    wv = min(max(width_v_m * (1.0 / _WINDOW_PERIOD_V_M), 1e-3), 0.4)
    left, low = u - cu - 0.5 * wu, v - cv - 0.5 * wv
    right, high = left + wu, low + wv
    across, up = _overlap(left, right, 0.22, 0.78), _overlap(low, high, 0.3, 0.8)
    # The bars between the panes of a window are 0.4 glass.
    clear = (across - _overlap(left, right, 0.48, 0.52)) * (up - _overlap(low, high, 0.605, 0.635))
    pane = (0.4 * across * up + 0.6 * clear) / (wu * wv)
    glass = pane + blur * (0.27 - pane)
    number = (np.int64(cu) * 73856093) ^ (np.int64(cv) * 19349663)
    number = (number ^ (number >> 11)) * 0x5BD1E995
    lit = 0.6 + 0.4 * float((number >> 25) & 1)
    lit = lit if float((number >> 13) & 1023) < lit_share * 1024.0 else 0.0
    lit += blur * (lit_share - lit)
    return glass, glass * lit
