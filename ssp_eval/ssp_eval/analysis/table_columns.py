"""Columns that several tables share, and the order of their rows."""

from __future__ import annotations

from collections.abc import Iterable

from ssp_core.vocabulary import DOMAINS
from ssp_eval.analysis.table import Column

SCORES = (
    Column("jovr", "JOVR"),
    Column("sem_cov", "SemCov"),
    Column("sem_acc_eff", "SemAcc"),
    Column("cia_eff", "CIA"),
    Column("tqsr", "TQSR"),
    Column("ivcs", "IVCS"),
    Column("act_acc_eff", "ActAcc"),
    Column("stfr", "STFR"),
    Column("atc_eff", "ATC"),
)
MEANS = (
    *SCORES[:5],
    Column("rsr", "RSR"),
    Column("rl_s", "RL (s)", "seconds"),
    *SCORES[5:],
)
TITLES = {column.key: column.title for column in MEANS}
COUNT = Column("n", "n", "count")


def in_order(group: Iterable[str]) -> list[tuple[int, str]]:
    """Key that sorts domains in their own order and everything else by name."""
    return [(DOMAINS.index(key) if key in DOMAINS else len(DOMAINS), key) for key in group]
