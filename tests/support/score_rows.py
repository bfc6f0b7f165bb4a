"""Rows of made-up matrices, from numbers that are the same every time."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

from ssp_core.vocabulary import DOMAINS
from ssp_eval.statistics.rows import CellRow

MODELS = ("openemma", "alpamayo", "impromptu_vla")
MANY = tuple(
    f"{family}-{kind}{tail}"
    for family in ("OpenDrive", "Qwen2.5-VL", "Lynx", "Senna", "DriveLM")
    for kind in ("base", "large", "chat")
    for tail in ("", "-72B-Instruct-v0.2")
)
SCENARIOS = ("cut_in", "vru_crossing")


COMPONENT_SCORES = ("jovr", "sem_acc_eff", "cia_eff", "act_acc_eff", "tqsr", "atc_eff")


def row(
    scenario: str = "s",
    domain: str = "physical",
    model: str = "m",
    value: float | None = 0.5,
    **others: Any,
) -> CellRow:
    """A row with one value in all component scores, and no response."""
    scores: dict[str, Any] = dict.fromkeys(COMPONENT_SCORES, value) | {"rsr": 0, "rl_s": None}
    return CellRow(scenario, domain, model, **(scores | others))


def rows_of(
    models: Sequence[str] = MODELS, scenarios: Sequence[str] = SCENARIOS, seed: int = 1
) -> list[CellRow]:
    """One row per scenario, domain and model, some with a null, a third without facts."""
    numbers = random.Random(seed)
    skills = {model: numbers.uniform(0.2, 0.8) for model in models}
    found = []
    for scenario in scenarios:
        for domain in DOMAINS:
            for index, model in enumerate(models):

                def score(skill: float = skills[model]) -> float:
                    return min(1.0, max(0.0, numbers.gauss(skill, 0.12)))

                responds = numbers.random() < skills[model]
                found.append(
                    CellRow(
                        scenario,
                        domain,
                        model,
                        jovr=score(),
                        sem_acc_eff=score(),
                        cia_eff=None if numbers.random() < 0.1 else score(),
                        act_acc_eff=score(),
                        tqsr=score(),
                        atc_eff=score(),
                        rsr=1.0 if responds else 0.0,
                        rl_s=0.5 if responds else None,
                        total_b=None if index % 3 == 2 else 7.0 * (index + 1),
                        active_b=None if index % 3 == 2 else 1.5 * (index + 1),
                        architecture=("dense", "mixture of experts", "")[index % 3],
                    )
                )
    return found
