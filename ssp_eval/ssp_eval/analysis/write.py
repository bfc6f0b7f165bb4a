"""Writes the tables and statistics of a set of cells into a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from ssp_core import __version__
from ssp_core.files import make_folder, write_json, write_text
from ssp_eval.analysis.formats import FORMATS, to_data
from ssp_eval.analysis.notices import Notice
from ssp_eval.analysis.resample import LEVEL
from ssp_eval.analysis.statistics import Options
from ssp_eval.analysis.table import Table
from ssp_eval.score import DEFAULT
from ssp_eval.score.show import DISCLAIMER

STATISTICS_FILE = "statistics.json"
STATISTICS_SCHEMA = "ssp.statistics/2"


def write_tables(
    folder: Path,
    tables: Iterable[Table],
    formats: Sequence[str],
    on_table: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Writes each table in each format, as ``<name>.csv``, ``.tex``, ``.json``, ``.html``.

    What must be read beside a CSV file stands in ``<name>.notes.txt``.

    Args:
        folder: made where it isn't there.
        tables: with different names.
        formats: keys of FORMATS.
        on_table: called once for each table.

    Raises:
        InputError: the folder can't be written to.
    """
    make_folder(folder)
    written = []
    for table in tables:
        for name in formats:
            for suffix, convert in FORMATS[name]:
                path = folder / f"{table.name}{suffix}"
                write_text(path, convert(table))
                written.append(path)
        on_table()
    return written


def write_statistics(
    folder: Path,
    tables: Iterable[Table],
    options: Options,
    notices: Sequence[Notice] = (),
    thresholds: str = "",
) -> Path:
    """Writes ``statistics.json``: all digits of the statistics, and what they were made with.

    Args:
        folder: to write into.
        tables: of the statistics.
        options: they were made with.
        notices: what must be known before reading them.
        thresholds: hash of those of the cells; empty: METHOD's.
    """
    path = make_folder(folder) / STATISTICS_FILE
    write_json(
        path,
        {
            "schema": STATISTICS_SCHEMA,
            "seed": options.seed,
            "resamples": options.resamples,
            "block_labels": options.block,
            "level": LEVEL,
            "thresholds": thresholds or DEFAULT.sha256,
            "software": f"ssp {__version__}",
            "note": DISCLAIMER,
            "notices": [asdict(notice) for notice in notices],
            "tables": [to_data(table) for table in tables],
        },
    )
    return path
