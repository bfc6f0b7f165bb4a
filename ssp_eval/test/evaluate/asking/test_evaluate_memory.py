"""Memory of an evaluation doesn't grow with the recording (stamps apart)."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from pathlib import Path

from ssp_core.bag.reading.reader import BagReader
from ssp_eval.data.provenance import find_labels
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions

BagMaker = Callable[..., Path]
SHORT_S, LONG_S = 10.0, 100.0
# A message leaves its stamps and its place in the file; a decoded state takes 900.
MOST_PER_MESSAGE = 250
# What is held once for all (modules, compiled patterns, types) falls into any one of the runs.
TIMES = 2


def peak_bytes(bag: Path, labels: Path | None, out: Path) -> int:
    """The most that Python held at once while a bag was evaluated."""
    gc.collect()
    # The more is held, the later all of it is collected: what other tests left would let garbage
    # of a long recording pile up.
    gc.freeze()
    tracemalloc.start()
    try:
        (result,) = run_campaign(
            [(bag, labels)],
            [bridge_spec("copy_history")],
            InProcessClients(),
            out,
            CellOptions(),
            labels is None,
        )
        assert result.status == "ok"
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        gc.unfreeze()


def test_a_recording_ten_times_as_long_takes_no_more_memory(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    short, long = make_bag("short", duration_s=SHORT_S), make_bag("long", duration_s=LONG_S)
    peak_bytes(short, None, tmp_path / "warm")
    labels = find_labels(short)
    one, ten = (
        min(peak_bytes(bag, labels, tmp_path / f"{bag.name}{i}") for i in range(TIMES))
        for bag in (short, long)
    )
    with BagReader(short) as few, BagReader(long) as many:
        assert ten <= one + MOST_PER_MESSAGE * (many.count - few.count)
