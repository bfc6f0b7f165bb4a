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
def window_mix(u_m: float, v_m: float, footprint_m: float, lit_share: float) -> tuple[float, float]:
    """Share of glass and share of lit window (of 1) at a place of a facade.

    The share goes to its mean where the footprint of a sample no longer resolves a window.
    """
    blur = min(1.0, max(0.0, (footprint_m - 0.5) / 1.0))
    cu, cv = math.floor(u_m / _WINDOW_PERIOD_U_M), math.floor(v_m / _WINDOW_PERIOD_V_M)
    pu, pv = u_m / _WINDOW_PERIOD_U_M - cu, v_m / _WINDOW_PERIOD_V_M - cv
    glass = 1.0 if 0.22 < pu < 0.78 and 0.3 < pv < 0.8 else 0.0
    if glass > 0.0 and (abs(pu - 0.5) < 0.02 or abs(pv - 0.62) < 0.015):
        glass = 0.4
    glass += blur * (0.27 - glass)
    number = (int(cu) * 73856093) ^ (int(cv) * 19349663)
    number = (number ^ (number >> 11)) * 0x5BD1E995
    lit = 1.0 if ((number >> 13) & 1023) < lit_share * 1024.0 else 0.0
    lit *= 0.6 + 0.4 * ((number >> 25) & 1)
    lit += blur * (lit_share - lit)
    return glass, glass * lit
