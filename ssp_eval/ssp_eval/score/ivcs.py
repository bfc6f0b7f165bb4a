"""The composite score (METHOD 6.10), for one cell or for arrays of cells."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ssp_eval.score.thresholds import DEFAULT, Thresholds


def ivcs_weights(thresholds: Thresholds = DEFAULT) -> dict[str, float]:
    """The weight of each component of IVCS by its key in the score output (METHOD 6.10)."""
    return {
        "jovr": thresholds.weight_jovr,
        "sem_acc_eff": thresholds.weight_sem_acc_eff,
        "cia_eff": thresholds.weight_cia_eff,
        "tqsr": thresholds.weight_tqsr,
        "rsr": thresholds.weight_rsr,
    }


def ivcs_terms(
    components: Mapping[str, float | None], thresholds: Thresholds = DEFAULT
) -> dict[str, float]:
    """What each component adds to IVCS (METHOD 6.10); a null one adds 0 (METHOD 6.11).

    Args:
        components: ``jovr``, ``sem_acc_eff``, ``cia_eff``, ``tqsr`` and ``rsr``, each 0..1 or None;
            others are ignored.
        thresholds: the weights.
    """
    return {
        name: weight * (components[name] or 0.0)
        for name, weight in ivcs_weights(thresholds).items()
    }


def ivcs(components: Mapping[str, float | None], thresholds: Thresholds = DEFAULT) -> float:
    """IVCS = 0.10 JOVR + 0.30 SemAcc_eff + 0.20 CIA_eff + 0.30 TQSR + 0.10 RSR (METHOD 6.10).

    Args:
        components: see ivcs_terms.
        thresholds: the weights.
    """
    return math.fsum(ivcs_terms(components, thresholds).values())
