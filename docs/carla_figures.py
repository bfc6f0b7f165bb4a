"""Draws the pictures of docs/carla.md: ``python docs/carla_figures.py RUN MAP MOVED``.

RUN is a session of our own camera, MAP the OpenDRIVE file that stands for its ground, MOVED a
session with ``--plant carla://…``. The server is the counterpart of the tests: it draws flat boxes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

from ssp_core.bag.reader import BagReader, object_states
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.steps import decode_tick
from ssp_core.clock import NS_PER_S
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SHOWN_S = (10.5, 11.5, 12.5)
WIDTH_PX, QUALITY = 310, 85

sys.path.insert(0, str(ROOT / "tests"))
from support.carla_commands import ssp  # noqa: E402 - of the tests, which are no package
from support.carla_counterpart import Behaviour, Counterpart  # noqa: E402


def frames(bag: Path) -> list[np.ndarray]:
    """The frames nearest to the times that are shown."""
    with BagReader(bag) as reader:
        found = [
            read_image(COMPRESSED_TYPE, m.data) for m in reader.messages([absolute(CAMERA_IMAGE)])
        ]
    chosen = [min(found, key=lambda f: abs(f.stamp_ns / NS_PER_S - t_s)) for t_s in SHOWN_S]
    shown = []
    for one in chosen:
        picture = cv2.imdecode(np.frombuffer(one.data, np.uint8), cv2.IMREAD_COLOR)
        height = round(picture.shape[0] * WIDTH_PX / picture.shape[1])
        shown.append(cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA))
    return shown


def pictures(run: Path, chart: Path) -> None:
    """A session of our camera above the same states drawn anew."""
    with (
        tempfile.TemporaryDirectory() as folder,
        Counterpart(Behaviour(xodr=chart.read_text())) as server,
    ):
        out = Path(folder) / "drawn"
        camera = ("--map", chart, "--camera", f"carla://{server.address}")
        ((status, text),) = ssp(("draw", run, *camera, "--out", out))
        assert status == 0, text
        rows = [np.hstack(frames(one)) for one in (run / "bag", out)]
    cv2.imwrite(
        str(IMAGES / "carla-drawn.jpg"), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    )


def motion(moved: Path) -> None:
    """Speeds of VUT and object target, and the object's distance to its reference."""
    with BagReader(moved / "bag") as reader:
        ticks = (decode_tick(one.data) for one in reader.messages([absolute(WORLD_TICK)]))
        first = next(tick.stamp_ns for tick in ticks if tick.running)
        found = object_states(reader, ["vut", "ot1"])
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.5, 3.6), sharex=True)
    for name, states in found.items():
        run = [s for s in states if s.stamp_ns >= first]
        times_s = [s.stamp_ns / NS_PER_S for s in run]
        above.plot(times_s, [s.speed_mps for s in run], label=name)
        if name == "ot1":
            below.plot(times_s, [s.error_longitudinal_m for s in run], label="along")
            below.plot(times_s, [s.error_lateral_m for s in run], label="beside")
    above.set_ylabel("speed, m/s")
    below.set_ylabel("ot1 from its\nreference, m")
    below.set_xlabel("session time, s")
    for axis in (above, below):
        axis.legend(frameon=False)
        axis.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(IMAGES / "carla-plant.svg", metadata={"Date": None})


if __name__ == "__main__":
    pictures(Path(sys.argv[1]), Path(sys.argv[2]))
    motion(Path(sys.argv[3]))
