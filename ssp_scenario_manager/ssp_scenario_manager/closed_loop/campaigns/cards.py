"""The cards of a campaign: what each driver is, and the conditions that it drove under.

Results with unlike cards are not comparable. Hardware decides nothing where each latency is fixed;
where one is measured, it stands under the card's hash, and what was measured doesn't: it is put
onto the card when all runs are done.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.compiled import core_in_use
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_json
from ssp_core.run_file.driven import COMMANDED
from ssp_core.run_file.latency import Latency, parse_latency
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import GivenAnswer, model_facts, sees_frames
from ssp_core.world.providers import Provider
from ssp_scenario_manager.closed_loop.answers import load_answers, row_file
from ssp_scenario_manager.closed_loop.campaigns.forms import SealedCards, check_form, read_sealed
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL, CAREFUL_DRIVER
from ssp_scenario_manager.closed_loop.outcomes.outcome import figures_of
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, Row
from ssp_scenario_manager.closed_loop.values import LIMITS

CARDS_FILE = "cards.json"
CARDS_SCHEMA = "ssp.loop_cards/1"
MEASURED_CONTAINS = (
    "encoding of pictures and request, transport and inference with waits and further tries, "
    "parsing; no rendering"
)
_MEASURED = (
    *("answers", "p50_s", "p99_s", "encoding_p50_s", "transport_and_inference_p50_s"),
    *("parsing_p50_s", "over_bound"),
)
_WORDLESS = "asked without words"
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
    there = read_sealed(path)
    check_form(SealedCards, there, path)
    cards = list(there["cards"])
    for i, one in enumerate(cards):
        if one["hash"] != _hash(one):
            raise InputError(
                "was changed after it was sealed",
                file=path,
                field=f"cards[{i}]",
                remedy="name a new folder with --out",
            )
    return cards


def _card(
    plan: LoopPlan, driver: CampaignDriver, starts: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    run = RunSpec.model_validate(starts[0]["run"])
    facts = Provider.DRIVING_FACTS.load().driving_facts(run.vut.cls)
    is_prescribed = driver.driver == CAREFUL
    perception = _perception(driver, starts[0])
    has_route = perception.pop("sees_route")
    card = {
        "driver": driver.display_name,
        "kind": driver.driver,
        "options": asdict(CAREFUL_DRIVER) if is_prescribed else driver.options,
        "privileged": driver.is_privileged,
        "history_s": None if is_prescribed else facts["history_s"],
        **perception,
        "route_m": None if is_prescribed or not has_route else facts["route_m"],
        "step_s": run.step_s,
        "frame_period_s": starts[0]["frame_period_s"],
        "latencies": [_latency(one, driver.driver) for one in plan.latencies],
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
        "compiled_core": core_in_use(),
        "hardware": _hardware(),
    }
    return {**card, "hash": _hash(card)}


def _perception(driver: CampaignDriver, start: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a driver sees, and what is known of its model; None: it has none of it."""
    if driver.driver == CAREFUL or not sees_frames(driver.driver):
        nothing = dict.fromkeys(("model", "weights_sha256", "prompt_sha256", "timeout_s"))
        return {"cameras": [], **nothing, "prompt": _WORDLESS, "sees_route": True}
    camera = start.get("camera") or {}
    camera_fields = ("width_px", "height_px", "hfov_deg", "rate_hz", "renderer")
    return {
        "cameras": [{name: camera[name] for name in camera_fields if name in camera}],
        **model_facts(driver.driver, driver.options),
    }


def _latency(latency: Latency, driver: str) -> dict[str, Any]:
    """Return what a card says of an L before it is driven under.

    A quantile is None where it isn't known yet, or nothing is asked.
    """
    if latency.measured and driver != CAREFUL and sees_frames(driver):
        figures = dict.fromkeys(_MEASURED)
        return {"given": str(latency), **figures, "contains": MEASURED_CONTAINS}
    seconds = None
    if driver not in (*COMMANDED, CAREFUL):
        seconds = 0.0 if latency.measured else latency.seconds
    contains = "computed in no time" if latency.measured else "a constant"
    return {"given": str(latency), "p50_s": seconds, "p99_s": seconds, "contains": contains}


def complete_cards(folder: Path, rows: Sequence[Row]) -> None:
    """Put the latencies that were measured onto the cards of a campaign.

    Args:
        folder: of the campaign.
        rows: of ``runs.csv``, all of them.
    """
    path = folder / CARDS_FILE
    cards = load_cards(path)
    for card in cards:
        for latency in card["latencies"]:
            if latency["contains"] == MEASURED_CONTAINS:
                latency.update(_measured(folder, rows, card["driver"], latency["given"]))
    write_json(path, {"schema": CARDS_SCHEMA, "cards": cards})


def _measured(folder: Path, rows: Sequence[Row], driver: str, latency: str) -> dict[str, Any]:
    """Return what was measured of a driver's answers, over events and event-free twins."""
    given_answers: list[GivenAnswer] = []
    for number, row in enumerate(rows, 1):
        cells = dict(zip(RUN_COLUMNS, row, strict=True))
        path = row_file(folder, number)
        if (cells["driver"], cells["latency"]) == (driver, latency) and path.is_file():
            answers = load_answers(path, "name a new folder with --out")
            given_answers += [one.given for one in (*answers.event, *answers.free)]
    figures = figures_of(given_answers, parse_latency(latency).seconds)
    return {name: figures[name] for name in _MEASURED}


def _hash(card: Mapping[str, Any]) -> str:
    # Compiled or not, the bytes are the same.
    left_out = ["hash", "compiled_core"]
    latencies = [dict(one) for one in card["latencies"]]
    if any(parse_latency(one["given"]).measured for one in latencies):
        for one in latencies:
            if one["contains"] == MEASURED_CONTAINS:
                one.update(dict.fromkeys(_MEASURED))
    else:
        left_out.append("hardware")
    content = {k: v for k, v in card.items() if k not in left_out}
    return sha256_json({**content, "latencies": latencies})


def _hardware() -> dict[str, Any]:
    return {
        "machine": platform.machine(),
        "processor": _processor(),
        "system": f"{sys.platform} {platform.release()}",
        "cores": os.cpu_count(),
    }


def _processor() -> str:
    """Return the model of the processor; empty where the system doesn't tell it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((s.partition(":")[2].strip() for s in lines if s.startswith("model name")), "")
