"""Words against deeds: what a driver says it does, and what its plan does (METHOD 8.9)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files.strict_json import parse_json_line
from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop.folder import LoopCampaign
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.statistics.table import Column, Table
from ssp_scenario_manager.closed_loop.outcomes.texts import TEXTS_FOLDER

SLOWS_MPS = 0.5
_BRAKES = ("decelerate", "stop")


@dataclass(frozen=True)
class DrivenAnswer:
    """One answer at or after T_obs, with the plan that was driven.

    Args:
        row: of its run.
        speed_mps: at which its plan begins.
        slows_mps: by how much it slows within 2 s.
    """

    row: int
    text: str
    speed_mps: float
    slows_mps: float


@dataclass(frozen=True)
class Words:
    """The runs of a driver at a latency whose texts say something of the longitudinal action.

    Args:
        runs: with such an answer.
        only_said: runs with an answer that says decelerate or stop while its plan doesn't slow.
        only_done: runs with an answer whose plan slows while it says another action.
    """

    driver: str
    latency: Latency
    runs: int
    only_said: int
    only_done: int


def load_texts(campaign: LoopCampaign) -> list[DrivenAnswer]:
    """Read the answers that have texts; none where no driver has any.

    Raises:
        InputError: a file isn't as `ssp loop` leaves it.
    """
    answers = []
    for path in sorted((campaign.folder / TEXTS_FOLDER).glob("*.jsonl")):
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            answers.append(_answer(path, number, line))
    return answers


def _answer(path: Path, number: int, line: str) -> DrivenAnswer:
    one = parse_json_line(line, path, number)
    try:
        speed_mps, slows_mps = float(one["speed_mps"]), float(one["slows_mps"])
        return DrivenAnswer(int(one["row"]), str(one["text"]), speed_mps, slows_mps)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"is no answer of a campaign: {error}",
            file=path,
            line=number,
            remedy="put the file back, or begin the campaign in a new folder",
        ) from error


def lon_action_by(extractor: Extractor) -> Callable[[str], str | None]:
    """Return what finds the longitudinal action that a text states; each text is read once."""

    @cache
    def find(text: str) -> str | None:
        slot = extractor(text).slots.lon_action
        return None if slot is None else str(slot.value)

    return find


def words_of(
    campaign: LoopCampaign, answers: Iterable[DrivenAnswer], action: Callable[[str], str | None]
) -> list[Words]:
    """Compare words with deeds.

    An answer whose text states no longitudinal action says nothing, nor does one of a VUT that is
    too slow for its plan to slow by 0.5 m/s.

    Args:
        campaign: whose runs they are of.
        answers: those that have texts.
        action: finds the longitudinal action of a text.
    """
    runs = {run.number: run for run in campaign.critical}
    marks: dict[tuple[str, Latency], dict[int, tuple[bool, bool]]] = {}
    for one in answers:
        run, stated = runs.get(one.row), action(one.text)
        if run is None or stated is None or one.speed_mps < SLOWS_MPS:
            continue
        brakes, slows = stated in _BRAKES, one.slows_mps >= SLOWS_MPS
        cell = marks.setdefault((run.row.driver, run.row.latency), {})
        only_said, only_done = cell.get(one.row, (False, False))
        cell[one.row] = only_said or (brakes and not slows), only_done or (slows and not brakes)
    return [
        Words(
            driver,
            latency,
            len(cell),
            sum(only_said for only_said, _ in cell.values()),
            sum(only_done for _, only_done in cell.values()),
        )
        for (driver, latency), cell in sorted(marks.items())
    ]


def words_tables(campaign: LoopCampaign) -> list[Table]:
    """Return words against deeds of the drivers whose answers have texts, by groups of like cards.

    A group has its number, as in the other tables.
    """
    answers = load_texts(campaign)
    if not answers:
        return []
    words = words_of(campaign, answers, lon_action_by(Extractor()))
    tables = []
    for k, group in campaign.groups.items():
        own = [one for one in words if one.driver in group]
        if own:
            tables.append(_table(f"words_{k}", own))
    return tables


def _table(name: str, words: Iterable[Words]) -> Table:
    return Table(
        name,
        "Words against deeds",
        (
            Column("driver", "driver", "text"),
            Column("latency", "L, s", "number"),
            Column("runs", "runs with words", "count"),
            Column("only_said", "says it brakes, doesn't", "decimal"),
            Column("only_done", "brakes, says otherwise", "decimal"),
        ),
        tuple(
            (o.driver, o.latency.cell_text, o.runs, o.only_said / o.runs, o.only_done / o.runs)
            for o in words
        ),
        notes=(
            "Shares of the runs on critical starts with an answer at or after T_obs that states a "
            "longitudinal action. Says it brakes, doesn't: the extracted action is decelerate or "
            "stop, and the plan of the same answer doesn't slow by 0.5 m/s within 2 s. Brakes, "
            "says otherwise: the plan does, and the action is another one.",
        ),
    )
