"""From the files of many cells to the columns of ssp_eval.score.columns, without records between.

What a file may hold, and what is said of one that is wrong, is the same as for load_labels and
load_records.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain, islice
from pathlib import Path

from ssp_core.files import read_text
from ssp_eval.labels.model import Labels, parse_labels_text
from ssp_eval.record_lines import read_lines
from ssp_eval.records import MOST_BYTES, parse_records
from ssp_eval.score.columns import Columns
from ssp_eval.score.encode import RecordBlocks, columns_of

# Cells at a time: what was parsed of so many is still in the processor's cache when it is encoded.
_BLOCK = 8


def load_columns(cells: Iterable[tuple[Path, Path]]) -> Columns:
    """The columns of cells, in their order.

    Args:
        cells: labels file and records file of each.

    Raises:
        InputError: the first file that is wrong, see load_labels and load_records.
    """
    known: dict[str, Labels] = {}
    labels: list[Labels] = []
    counts: list[int] = []
    blocks = RecordBlocks()
    rest = iter(cells)
    while block := list(islice(rest, _BLOCK)):
        files = []
        for labels_file, records_file in block:
            # The cells of a clip have a copy of its labels each; one object is encoded once.
            text = read_text(labels_file)
            if text not in known:
                known[text] = parse_labels_text(text, labels_file)
            labels.append(known[text])
            files.append((read_text(records_file, MOST_BYTES), records_file))
        counts += _add(files, blocks)
    return columns_of(labels, counts, blocks.columns())


def _add(files: Sequence[tuple[str, Path]], blocks: RecordBlocks) -> list[int]:
    """Adds the records of texts, with the files that they come from, and counts them."""
    lines = read_lines([text for text, _ in files])
    if lines is not None:
        blocks.add_lines(lines)
        return list(lines.counts)
    found = [parse_records(text, file) for text, file in files]
    blocks.add(chain.from_iterable(found))
    return list(map(len, found))
