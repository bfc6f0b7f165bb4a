"""A measure, or a review's outcome, as tables for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from rich.table import Table

from ssp_core import console
from ssp_eval.extract.measure import Estimate, Measure, Score
from ssp_eval.extract.review.agreement import Review

_WIDEST = 400


def show_measure(measurement: Measure, misses: bool) -> None:
    """Print the tables, and where it is asked for each slot that came out otherwise."""
    _line(f"{measurement.texts} texts; intervals are Wilson's for 95 %")
    _print_scores("slot", "wanted", measurement.slots)
    _print_scores("class", "wanted", measurement.classes)
    _print_scores("style", "wanted", {name: one["all"] for name, one in measurement.styles.items()})
    spans = _table("evidence of right answers", "inside the label's", "overlapping", "elsewhere")
    for name, counts in measurement.spans.items():
        spans.add_row(name, *map(str, counts.values()))
    _print(spans)
    for name, confusion in measurement.confusion.items():
        _print(_confusion(name, confusion))
    for row in measurement.misses if misses else ():
        _line(f"{row.key}  {row.slot}: wanted {row.shown[0]}, given {row.shown[1]}")


def show_review(review: Review) -> None:
    """Print agreement, the extractor's figures, its errors and what is to be settled."""
    _line(
        f"{review.texts} texts, drawn evenly over what was extracted: shares are of these texts, "
        "not of all; intervals are for 95 %"
    )
    table = _table("reviewers", "judged", "unsure", "agreement", "kappa", "classes shared")
    for name, slot in review.slots.items():
        overlap = "" if slot.overlap is None else f"{slot.overlap:.3f}"
        counts = str(slot.judged), str(slot.unsure)
        table.add_row(name, *counts, _estimate(slot.agreement), _estimate(slot.kappa), overlap)
    _print(table)
    scores = {name: slot.score for name, slot in review.slots.items()}
    _print_scores("extractor", "agreed on", scores)
    _line("\nThe extractor against both reviewers:")
    for error in review.errors:
        kind = error.kind.replace("_", " ")
        words = f"both say {error.agreed}, extracted {error.extracted}"
        _line(f"  {error.review_id} ({error.source_id})  {error.slot}: {kind}: {words}")
    if not review.errors:
        _line("  no difference")
    _line("\nTo settle between the reviewers:")
    for one in review.disagreements:
        _line(f"  {one.review_id}  {one.slot}: {one.first} or {one.second}")
    if not review.disagreements:
        _line("  nothing")


def _line(text: str) -> None:
    console.out.print(text, markup=False)


def _print(table: Table) -> None:
    """Print a table after an empty line, as wide as it needs to be."""
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print()
    console.out.print(table)


def _table(first: str, *others: str) -> Table:
    """Return a table of names with figures to their right."""
    table = Table(box=None, pad_edge=False)
    table.add_column(first, no_wrap=True)
    for name in others:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _estimate(estimate: Estimate) -> str:
    """``0.950 [0.900, 0.980]``; a dash where it has no sense."""
    if estimate.value is None or estimate.interval is None:
        return "–"
    low, high = estimate.interval
    return f"{estimate.value:.3f} \\[{low:.3f}, {high:.3f}]"


def _print_scores(title: str, label_heading: str, scores: Mapping[str, Score]) -> None:
    """Print precision, recall and F1 by name; ``label_heading`` heads the number of labels."""
    table = _table(title, "precision", "recall", "F1", "given", label_heading, "right")
    for name, score in scores.items():
        table.add_row(
            name,
            _estimate(score.precision),
            _estimate(score.recall),
            "–" if score.f1 is None else f"{score.f1:.3f}",
            *(str(count) for count in (score.given, score.wanted, score.right)),
        )
    _print(table)


def _confusion(name: str, counts: Counter[tuple[str, str]]) -> Table:
    if name == "objects":  # sets of classes are too many for a square
        table = Table("objects: wanted", "given", "texts", box=None, pad_edge=False)
        for (label, answer), number in counts.most_common():
            if label != answer:
                table.add_row(label, answer, str(number))
        return table
    rows = sorted({pair[0] for pair in counts})
    columns = sorted({pair[1] for pair in counts})
    table = _table(f"{name}: wanted (rows), given (columns)", *columns)
    for row in rows:
        table.add_row(row, *(str(counts[row, column] or "·") for column in columns))
    return table
