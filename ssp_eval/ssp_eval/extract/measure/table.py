"""A measure as tables for people."""

from __future__ import annotations

from collections.abc import Mapping

from rich.table import Table

from ssp_core import console
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.extract.measure.corpus import STYLES
from ssp_eval.extract.measure.counts import Measure, Score
from ssp_eval.extract.measure.intervals import Share

_WIDEST = 400


def show(found: Measure, misses: bool) -> None:
    """Prints the tables.

    Args:
        found: what was counted.
        misses: list each slot that came out otherwise, too.
    """
    console.out.print(f"{found.texts} texts; intervals are Wilson's for 95 %", markup=False)
    print_table(score_table("slot", "wanted", found.slots))
    print_table(score_table("class", "wanted", found.classes))
    styles = {s: found.styles[s]["all"] for s in STYLES if s in found.styles}
    print_table(score_table("style", "wanted", styles))
    print_table(_spans(found))
    for name in SLOT_NAMES:
        print_table(_confusion(found, name))
    if misses:
        for miss in found.misses:
            line = f"{miss.key}  {miss.slot}: wanted {miss.wanted}, given {miss.given}"
            console.out.print(line, markup=False)


def share_text(share: Share) -> str:
    """``0.95 [0.90, 0.98]``; a dash of nothing."""
    if share.value is None or share.interval is None:
        return "–"
    low, high = share.interval
    return f"{share.value:.3f} \\[{low:.3f}, {high:.3f}]"


def print_table(made: Table) -> None:
    """Prints a table after an empty line, as wide as it needs to be."""
    unbounded = console.out.options.update(max_width=_WIDEST)
    made.width = console.out.measure(made, options=unbounded).maximum
    console.out.print()
    console.out.print(made)


def table(first: str, *others: str) -> Table:
    """A table of names with figures to their right."""
    made = Table(box=None, pad_edge=False)
    made.add_column(first, no_wrap=True)
    for name in others:
        made.add_column(name, justify="right", no_wrap=True)
    return made


def score_table(title: str, wanted: str, scores: Mapping[str, Score]) -> Table:
    """Precision, recall and F1 by name.

    Args:
        title: of the names.
        wanted: title of the number of labels.
        scores: by name.
    """
    made = table(title, "precision", "recall", "F1", "given", wanted, "right")
    for name, score in scores.items():
        made.add_row(
            name,
            share_text(score.precision),
            share_text(score.recall),
            "–" if score.f1 is None else f"{score.f1:.3f}",
            *(str(count) for count in (score.given, score.wanted, score.right)),
        )
    return made


def _spans(found: Measure) -> Table:
    made = table("evidence of right answers", "inside the label's", "overlapping", "elsewhere")
    for name, spans in found.spans.items():
        made.add_row(name, str(spans.inside), str(spans.overlapping), str(spans.elsewhere))
    return made


def _confusion(found: Measure, name: str) -> Table:
    counts = found.confusion[name]
    if name == "objects":  # sets of classes are too many for a square
        made = Table("objects: wanted", "given", "texts", box=None, pad_edge=False)
        for (wanted, given), number in counts.most_common():
            if wanted != given:
                made.add_row(wanted, given, str(number))
        return made
    rows = sorted({pair[0] for pair in counts})
    columns = sorted({pair[1] for pair in counts})
    made = table(f"{name}: wanted (rows), given (columns)", *columns)
    for row in rows:
        made.add_row(row, *(str(counts[row, column] or "·") for column in columns))
    return made
