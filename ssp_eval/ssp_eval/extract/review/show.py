"""A review's outcome as tables for people."""

from __future__ import annotations

from rich.table import Table

from ssp_core import console
from ssp_eval.extract.measure.table import print_table, score_table, share_text, table
from ssp_eval.extract.review.agreement import Kappa, Review


def show(review: Review) -> None:
    """Prints agreement, the extractor's figures, its errors and what is to be settled."""
    out = console.out
    out.print(
        f"{review.texts} texts, drawn evenly over what was extracted: shares are of these texts, "
        "not of all; intervals are for 95 %",
        markup=False,
    )
    print_table(_agreement(review))
    scores = {name: slot.score for name, slot in review.slots.items()}
    print_table(score_table("extractor", "agreed on", scores))
    out.print("\nThe extractor against both reviewers:", markup=False)
    for error in review.errors:
        words = f"both say {error.agreed}, extracted {error.extracted}"
        kind = error.kind.replace("_", " ")
        out.print(
            f"  {error.review_id} ({error.source_id})  {error.slot}: {kind}: {words}", markup=False
        )
    if not review.errors:
        out.print("  no difference", markup=False)
    out.print("\nTo settle between the reviewers:", markup=False)
    for one in review.disagreements:
        line = f"  {one.review_id}  {one.slot}: {one.first} or {one.second}"
        out.print(line, markup=False)
    if not review.disagreements:
        out.print("  nothing", markup=False)


def _agreement(review: Review) -> Table:
    found = table("reviewers", "judged", "unsure", "agreement", "kappa", "classes shared")
    for name, slot in review.slots.items():
        overlap = "" if slot.overlap is None else f"{slot.overlap:.3f}"
        found.add_row(
            name,
            str(slot.judged),
            str(slot.unsure),
            share_text(slot.raw),
            _kappa(slot.kappa),
            overlap,
        )
    return found


def _kappa(kappa: Kappa) -> str:
    if kappa.value is None or kappa.interval is None:
        return "–"
    low, high = kappa.interval
    return f"{kappa.value:.3f} \\[{low:.3f}, {high:.3f}]"
