"""The figures of a campaign of driven runs: outcomes over latency, and where the time went."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from ssp_core.run_file.latency import Latency
from ssp_eval import pages
from ssp_eval.closed_loop.folder import LoopCampaign, Run
from ssp_scenario_manager.closed_loop.outcomes.outcome import OUTCOMES
from ssp_scenario_manager.closed_loop.outcomes.rates import Rates

# Succeeding runs stand at the bottom, so that a bar's lowest part is the headline.
NEEDLESS = "avoided, but needless"
SHARES = ("avoided", NEEDLESS, *(kind for kind in reversed(OUTCOMES) if kind != "avoided"))
_WIDTH, _HEIGHT, _LEFT, _TOP, _BOTTOM = 236.0, 170.0, 8.0, 22.0, 34.0
_BAR = 0.72  # of the room of one latency


def class_of(share: str) -> str:
    """Return the class by which the style sheet colours an outcome."""
    return "needless" if share == NEEDLESS else share.replace("_", "-")


def counts_of(runs: Sequence[Run]) -> dict[str, int]:
    """Return how many runs have each outcome; an avoided one that is needless stands apart."""
    counts = dict.fromkeys(SHARES, 0)
    for run in runs:
        needless = run.row.outcome == "avoided" and run.row.needless
        counts[NEEDLESS if needless else run.row.outcome] += 1
    return counts


def outcome_plot(driver: str, runs: Sequence[Run], rates: Sequence[Rates]) -> str:
    """Return the outcome shares of a driver over the latencies of one event, as SVG.

    Args:
        driver: its name.
        runs: on critical starts of the event.
        rates: of the driver on the event, by rising latency.
    """
    room = (_WIDTH - 2 * _LEFT) / max(len(rates), 1)
    floor, height = _HEIGHT - _BOTTOM, _HEIGHT - _BOTTOM - _TOP
    parts = [pages.element("line", x1=_LEFT, x2=_WIDTH - _LEFT, y1=floor, y2=floor, class_="base")]
    for k, one in enumerate(rates):
        own = [run for run in runs if run.row.latency == one.latency]
        x, top = _LEFT + (k + (1 - _BAR) / 2) * room, floor
        for share, count in counts_of(own).items():
            if not count:
                continue
            part = height * count / len(own)
            top -= part
            tooltip = pages.title(
                f"{driver}, {one.latency.words}: {count} of {len(own)} {share.replace('_', ' ')}"
            )
            kind = class_of(share)
            parts.append(
                pages.element(
                    "rect", tooltip, x=x, y=top, width=_BAR * room, height=part, class_=kind
                )
            )
        middle = x + _BAR * room / 2
        label = "–" if one.headline is None else f"{one.headline:.2f}"
        parts += [
            pages.text(middle, _TOP - 7, label, text_anchor="middle", class_="value"),
            pages.text(middle, floor + 15, one.latency.cell_text, text_anchor="middle"),
        ]
    parts.append(pages.text(_WIDTH / 2, _HEIGHT - 4, "L, s", text_anchor="middle"))
    title = f"Outcomes of {driver} over latency"
    return pages.element(
        "svg",
        pages.title(title) + "".join(parts),
        class_="outcomes",
        viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}",
        role="img",
        aria_label=title,
    )


@dataclass(frozen=True)
class Chain:
    """Median times of a driver at a latency from T_obs on, s; None where no run has them.

    Args:
        wait_s: until the first frame.
        open_s: from there until a question is asked, while another one is open.
        answer_s: from there until its answer is effective.
        response_s: from there until the VUT departs from its twin; below 0 where it did before.
        responded: runs with a response.
        runs: in all.
    """

    driver: str
    latency: Latency
    wait_s: float | None
    open_s: float | None
    answer_s: float | None
    response_s: float | None
    responded: int
    runs: int

    @property
    def parts(self) -> list[tuple[str, float]]:
        """Parts of the bar, by class; a response before the answer has no length of its own."""
        durations = (
            *(("wait", self.wait_s), ("open", self.open_s)),
            *(("answer", self.answer_s), ("response", self.response_s)),
        )
        return [(name, value) for name, value in durations if value is not None and value > 0.0]

    @property
    def whole_s(self) -> float:
        """Length of the bar."""
        return sum(value for _, value in self.parts)


def chains_of(campaign: LoopCampaign, event: str) -> list[Chain]:
    """Return the chains of all drivers that answer questions, in the order of the table."""
    cells: dict[tuple[str, Latency], list[Run]] = {}
    for run in campaign.critical:
        if run.row.event == event and run.cells["asked_s"]:
            cells.setdefault((run.row.driver, run.row.latency), []).append(run)
    return [_chain(driver, latency, runs) for (driver, latency), runs in cells.items()]


def _chain(driver: str, latency: Latency, runs: Sequence[Run]) -> Chain:
    names = ("observable_s", "frame_s", "asked_s", "effective_s", "response_s")
    steps: list[float | None] = []
    for begin, end in pairwise(names):
        values = [
            last - first
            for run in runs
            if (first := run.value(begin)) is not None and (last := run.value(end)) is not None
        ]
        steps.append(median(values) if values else None)
    responded = sum(bool(run.cells["response_s"]) for run in runs)
    wait_s, open_s, answer_s, response_s = steps
    return Chain(driver, latency, wait_s, open_s, answer_s, response_s, responded, len(runs))
