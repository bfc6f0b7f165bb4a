"""The memory that an import of a long recording needs."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import cast

import numpy as np

from ssp_core.bag.writing.writer import BagWriter
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.importers.target import write_states
from ssp_eval.importers.tracks import Body, Samples, Source, Track


class Nowhere:
    """A writer that counts what it is given."""

    def __init__(self) -> None:
        self.written: dict[str, int] = {}

    def add_topic(self, topic: str, *_: object) -> None:
        self.written[topic] = 0

    def write(self, topic: str, *_: object) -> None:
        self.written[topic] += 1


def test_states_are_written_without_an_object_an_instant() -> None:
    count = 20_000
    stamps_ns = np.arange(count, dtype=np.int64) * 20_000_000
    still = dict.fromkeys(("x_m", "y_m", "yaw_rad", "speed_mps"), np.zeros(count))
    still |= dict.fromkeys(("acceleration_mps2", "yaw_rate_radps"), np.zeros(count))
    tracks = [
        Track(
            Body(name, ObjectClass.CAR, Role.OT, None, "rear_axle"),
            Samples(stamps_ns, still, Source(Path("a.mcap"), name)),
            (),
        )
        for name in ("a", "b")
    ]
    writer = Nowhere()
    tracemalloc.start()
    write_states(cast(BagWriter, writer), {t.body.object_id: t.states for t in tracks})
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert writer.written == {"/ssp/a/state": count, "/ssp/b/state": count, "/tf": count}
    # Blocks of 4,096 of each object; all states at once take 20 MB.
    assert peak_bytes < 6e6
