"""The cards of a campaign: what each driver is, and the conditions that it drove under.

Results with unlike cards are not comparable. Hardware decides nothing where each latency is fixed.
"""

from __future__ import annotations

import importlib
import json
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.files import write_json
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import model_facts, sees_frames
from ssp_scenario_manager.closed_loop.careful import CAREFUL, CAREFUL_DRIVER
from ssp_scenario_manager.closed_loop.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.values import LIMITS

CARDS_FILE = "cards.json"
CARDS_SCHEMA = "ssp.loop_cards/1"
# The drivers' package, which is used through its names alone, as make_driver is.
_FACTS_MODULE = "ssp_ot_controller.driving.facts"
_VERSIONS = ("numpy", "scipy", "pydantic")


def seal_cards(
    folder: Path, plan: LoopPlan, starts: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return the cards of a campaign, written before a driver runs.

    Args:
        folder: of the campaign.
        plan: the campaign.
        starts: sealed ones.

    Raises:
        InputError: the campaign began under other conditions.
    """
    cards = [_card(plan, driver, starts) for driver in plan.everybody]
    path = folder / CARDS_FILE
    if path.is_file():
        there = load_cards(path)
        if [one["hash"] for one in there] != [one["hash"] for one in cards]:
            raise InputError(
                "the campaign began under other conditions",
                file=path,
                remedy="name a new folder with --out",
            )
        return there
    write_json(path, {"schema": CARDS_SCHEMA, "cards": cards})
    return cards


def load_cards(path: Path) -> list[dict[str, Any]]:
    """Read the cards of a campaign.

    Raises:
        InputError: they were changed, or the file can't be read.
    """
    try:
        cards = json.loads(path.read_text())["cards"]
        sound = all(one["hash"] == _hash(one) for one in cards)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"can't be read: {error}", file=path) from error
    if not sound:
        raise InputError("was changed after it was sealed", file=path)
    return list(cards)


def _card(
    plan: LoopPlan, driver: CampaignDriver, starts: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    run = RunSpec.model_validate(starts[0]["run"])
    facts = importlib.import_module(_FACTS_MODULE).driving_facts(run.vut.cls)
    is_prescribed = driver.driver == CAREFUL
    card = {
        "driver": driver.shown,
        "kind": driver.driver,
        "options": asdict(CAREFUL_DRIVER) if is_prescribed else driver.options,
        "privileged": driver.is_privileged,
        "history_s": facts["history_s"],
        **_seen(driver, starts[0]),
        # Models get no centre line of their lane.
        "route_m": None if is_prescribed or sees_frames(driver.driver) else facts["route_m"],
        "step_s": run.step_s,
        "frame_period_s": starts[0]["frame_period_s"],
        "latencies": [
            {"given": text, "p50_s": value, "p99_s": value, "contains": "a constant"}
            for text, value in zip(plan.latencies, plan.latencies_s, strict=True)
        ],
        "d_max_mps2": facts["d_max_mps2"],
        "tracker": None if is_prescribed else facts["tracker"],
        "starts": plan.starts,
        "repeats": plan.repeats,
        "seed": plan.seed,
        "site": plan.site,
        "limits": {"outcome": asdict(LIMITS), "plan": facts["plan_limits"]},
        "versions": {
            "ssp": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in _VERSIONS},
        },
        "hardware": _hardware(),
    }
    return {**card, "hash": _hash(card)}


def _seen(driver: CampaignDriver, start: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a driver sees, and what is known of its model; None: it has none of it."""
    if not sees_frames(driver.driver):
        nothing = dict.fromkeys(("model", "weights_sha256", "timeout_s"))
        return {"cameras": [], **nothing}
    camera = start.get("camera") or {}
    named = ("width_px", "height_px", "hfov_deg", "rate_hz", "renderer")
    return {
        "cameras": [{name: camera[name] for name in named if name in camera}],
        **model_facts(driver.driver, driver.options),
    }


def _hash(card: Mapping[str, Any]) -> str:
    return sha256_json({k: v for k, v in card.items() if k not in ("hash", "hardware")})


def _hardware() -> dict[str, Any]:
    return {
        "machine": platform.machine(),
        "system": f"{sys.platform} {platform.release()}",
        "cores": os.cpu_count(),
    }
