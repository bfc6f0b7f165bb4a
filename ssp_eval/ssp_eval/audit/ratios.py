"""φ, EPD and KPR (METHOD 4): they qualify a recording and score no model."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ssp_eval.recordings.properties import FIELDS, Property, is_equal


def phase_fraction(t_s: float, start_s: float, end_s: float) -> float:
    """φ(d, e) = (t(d, e) − t(d, start)) / (t(d, end) − t(d, start)), METHOD 4.

    Args:
        t_s: time of the event, any clock.
        start_s: start of the clip on the same clock.
        end_s: its end, later than its start.

    Returns:
        In [0, 1] for a time inside the clip.

    Raises:
        ValueError: the clip has no length, or a time isn't finite.
    """
    if not all(map(math.isfinite, (t_s, start_s, end_s))) or end_s <= start_s:
        raise ValueError(f"a clip from {start_s} to {end_s} s has no fraction at {t_s} s")
    return (t_s - start_s) / (end_s - start_s)


def phase_difference(phi: Mapping[str, float], reference: Mapping[str, float]) -> float:
    """EPD(d) = (1/|E_s|) Σ_e |φ(d, e) − φ(Syn, e)|, METHOD 4.

    Args:
        phi: φ(d, e) per event.
        reference: φ(Syn, e) of the same events, at least one.

    Raises:
        ValueError: there are no events, or not the same ones.
    """
    if not reference or set(phi) != set(reference):
        raise ValueError(f"events {sorted(phi)} and {sorted(reference)} can't be compared")
    return math.fsum(abs(phi[e] - reference[e]) for e in reference) / len(reference)


def property_retention(
    found: Mapping[str, Property],
    reference: Mapping[str, Property],
    weights: Mapping[str, float] | None = None,
) -> float:
    """KPR(d) = Σ_k w_k [q(d, k) = q(Syn, k)] / Σ_k w_k, METHOD 4.

    Args:
        found: q(d, k) per field; a field that isn't there or isn't determined equals nothing.
        reference: q(Syn, k) of every field.
        weights: w_k ≥ 0 from part C of K*; 1 where not given.

    Raises:
        ValueError: the weights sum to 0, or one is negative or not finite.
    """
    given = weights or {}
    w = {k: given.get(k, 1.0) for k in FIELDS}
    total = math.fsum(w.values())
    if not math.isfinite(total) or total <= 0.0 or min(w.values()) < 0.0:
        raise ValueError(f"weights {w} can't be used")
    kept = math.fsum(w[k] for k in FIELDS if k in found and is_equal(found[k], reference[k]))
    return kept / total
