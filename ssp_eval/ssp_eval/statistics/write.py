"""Tables and statistics as parts of a page, and as files in a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from markupsafe import Markup

from ssp_core import __version__
from ssp_core.files import make_folder, write_json, write_text
from ssp_eval.score.cli import DISCLAIMER
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.notices import Notice
from ssp_eval.statistics.resampling import LEVEL
from ssp_eval.statistics.statistics import Options
from ssp_eval.statistics.table import FORMATS, Table, to_data, to_html

# Beyond, a table is only begun; the files of --tables hold it whole.
MOST_ROWS = 120
_PARTS = (
    ("Intervals", "intervals_"),
    ("Paired comparisons", "comparisons"),
    ("Sensitivity", "weights_"),
    ("Sensitivity", "sensitivity"),
    ("Stability over runs", "stability"),
    ("Curvature of the path", "curvature"),
)


@dataclass(frozen=True)
class Part:
    """One part of the page, its tables as HTML."""

    title: str
    tables: tuple[tuple[str, Markup], ...]


def page_parts(tables: Sequence[Table]) -> list[Part]:
    """The parts that there is something for, in a fixed order."""
    found: dict[str, list[tuple[str, Markup]]] = {}
    for title, prefix in _PARTS:
        for table in tables:
            if table.name.startswith(prefix) and table.rows:
                # to_html escapes every value.
                html = Markup(to_html(shortened(table)))
                found.setdefault(title, []).append((table.title, html))
    return [Part(title, tuple(of_part)) for title, of_part in found.items()]


def shortened(table: Table, most: int = MOST_ROWS) -> Table:
    """The first rows of a long table, with a note that says so."""
    if len(table.rows) <= most:
        return table
    note = f"The first {most} of {len(table.rows)} rows; ssp report --tables DIR writes all."
    return replace(table, rows=table.rows[:most], notes=(note, *table.notes))


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
