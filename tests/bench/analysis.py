"""10,000 resamples of a matrix of 18 cells with nine labels each: all scores, cells and means."""

from __future__ import annotations

import random

from measure import report
from scoring import a_cell, best_s

from ssp_core.vocabulary import DOMAINS
from ssp_eval.score.cell import score_cell
from ssp_eval.score.engine import LabelTerms, cell_terms
from ssp_eval.statistics.bootstrap import RESAMPLES, SEED, bootstrap_records, clip_generator
from ssp_eval.statistics.resampling import block_draws, block_of
from ssp_eval.statistics.rows import CellRow
from ssp_eval.statistics.statistics import GROUPINGS

MOST = 10.0  # times the drawing alone


def matrix() -> list[tuple[CellRow, LabelTerms]]:
    """Two scenarios, three domains, three models."""
    rng = random.Random(7)
    found = []
    for scenario in ("cut_in", "vru_crossing"):
        for domain in DOMAINS:
            for model in ("a", "b", "c"):
                labels, records = a_cell(rng)
                scores = score_cell(labels, records).to_json()
                names = ("jovr", "sem_acc_eff", "cia_eff", "act_acc_eff", "tqsr", "atc_eff")
                values = {name: scores[name] for name in (*names, "rsr", "rl_s")}
                found.append(
                    (CellRow(scenario, domain, model, **values), cell_terms(labels, records))
                )
    return found


def main() -> None:
    cells = matrix()

    def bare() -> None:
        for row, terms in cells:
            count = len(terms)
            rng = clip_generator(SEED, row, count)
            block_draws(count, block_of(count), RESAMPLES, rng)

    report(
        "analysis: bootstrap",
        best_s(lambda: bootstrap_records(cells, GROUPINGS)),
        best_s(bare),
        "s",
        f"{len(cells)} cells, {RESAMPLES} resamples, percentile and BCa; bound: drawing alone",
        lower=True,
        ratio_limit=MOST,
    )


if __name__ == "__main__":
    main()
