"""The statements of docs/recording.md, held against the code that keeps them."""

from __future__ import annotations

import re
from pathlib import Path

from ssp_core.bag.writing.split import REPEATED_KEY
from ssp_core.files.reading import MAX_TEXT_BYTES
from ssp_monitor.recorder.disk import LEAST_S
from ssp_monitor.recorder.encoding import ORIGINAL
from ssp_monitor.recorder.recorder import BATCH_BYTES
from ssp_monitor.recorder.report import MOST_S, REPORT_NAME, SCHEMA
from ssp_monitor.recorder.topics import MEANINGS, MOST_TOPICS, NOISE, Importance

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "recording.md").read_text()
FLAT = " ".join(TEXT.split())


def test_the_order_of_dropping_is_that_of_the_table() -> None:
    rows = re.findall(r"^\| (?:first |last |)\| (.+) \|$", TEXT, re.MULTILINE)
    assert rows == [MEANINGS[rank] for rank in sorted(Importance)]


def test_figures_and_names_are_those_of_the_code() -> None:
    for said in (
        f"`{REPORT_NAME}` (schema `{SCHEMA}`)",
        f"({MOST_TOPICS:,} for `ssp bag record`)",
        f"than {LEAST_S:g} s at the present rate",
        f"for at most {MOST_S:g} s; its last line",
        f"up to {BATCH_BYTES / 1e6:.0f} MB, can't be dropped",
        f"above {MAX_TEXT_BYTES >> 20} MiB",
        f"`{REPEATED_KEY}`",
        f"with `{ORIGINAL}` behind its name",
        *(f"`{name}`" for name in NOISE),
    ):
        assert said in FLAT, said
