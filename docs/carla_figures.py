"""Draws the pictures of docs/carla.md: ``python docs/carla_figures.py``, which takes some minutes.

Each command of the page runs as it stands there, and is shown as a terminal shows it. The server is
the counterpart of the tests: it draws flat boxes. Pages are shown by Chromium, without a window.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.steps import decode_tick
from ssp_core.clock import NS_PER_S
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SHOWN_S = (10.5, 11.5, 12.5)
WIDTH_PX, QUALITY = 310, 85
COLUMNS, PAGE_PX = 108, 900
BLOCK = ("--choose", "road 1 forward [0-312 m]", "--who", "Your Name")

sys.path.insert(0, str(ROOT))
from tests.support.carla.counterpart import Behaviour, Counterpart  # noqa: E402 - of the tests
from tests.support.carla.physics import Physics  # noqa: E402
from tests.support.carla.tasks import MAP  # noqa: E402
from tests.system.browser import Browser  # noqa: E402
from tests.system.recordings import Recordings, succeed  # noqa: E402

# A vehicle that hardly does what the event asks of it, uphill.
WEAK = Physics(engine=2.6, lag=0.4, drifts=-0.2)
_PAGE = (
    "<body style='margin:0;background:#0c0c0c'><pre style='display:inline-block;margin:0;padding:"
    "12px;background:#0c0c0c;color:#d9d9d9;font:13px/1.25 monospace'>{code}</pre></body>"
)


def terminal(folder: Path, address: str, *commands: tuple[str, ...]) -> str:
    """Run commands in a folder; HTML of what a terminal shows, with CARLA's usual port."""
    shown = io.StringIO()
    for arguments in commands:
        words = (f'"{one}"' if " " in one else one for one in arguments)
        done = subprocess.run(
            [sys.executable, "-m", "ssp_core.cli", *arguments],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            env={**os.environ, "COLUMNS": str(COLUMNS), "FORCE_COLOR": "1"},
        )
        lines = [one for one in done.stdout.splitlines() if "georeference" not in one]
        shown.write("\n".join([f"$ ssp {' '.join(words)}", *lines, "", ""]))
    said = shown.getvalue().rstrip().replace(address, "localhost:2000")
    console = Console(record=True, width=COLUMNS, file=io.StringIO())
    console.print(Text.from_ansi(said))
    return console.export_html(theme=MONOKAI, inline_styles=True, code_format=_PAGE)


def photograph(page: Path, target: str, *parts: tuple[str, str]) -> None:
    """Save parts of a page, below each other, as a picture of the docs.

    Args:
        page: its file.
        target: name of the picture.
        parts: JavaScript for the first and the last element of each.
    """
    with Browser((PAGE_PX, 400), dark=False) as browser:
        browser.go(page.as_uri())
        browser.resize(PAGE_PX, int(browser.evaluate("document.documentElement.scrollHeight")))
        boxes = [
            browser.evaluate(
                f"(() => {{ const a = ({first}).getBoundingClientRect(), "
                f"b = ({last}).getBoundingClientRect(); return [a.y, b.bottom]; }})()"
            )
            for first, last in parts
        ]
        browser.screenshot(page.with_suffix(".png"))
    whole = cv2.imread(str(page.with_suffix(".png")))
    rows = [whole[max(0, round(top)) : round(bottom)] for top, bottom in boxes]
    cv2.imwrite(str(IMAGES / target), np.vstack(rows), [cv2.IMWRITE_WEBP_QUALITY, QUALITY])


def element(selector: str) -> tuple[str, str]:
    """One element of a page, as a part of it."""
    found = f"document.querySelector({selector!r})"
    return found, found


def row(name: str) -> str:
    """A row of the audit's disclosures."""
    rows = "[...document.querySelectorAll('#disclosures tbody tr')]"
    return f"{rows}.find(r => r.cells[0].innerText === {name!r})"


def shown(folder: Path, html: str, target: str) -> None:
    """Save what a terminal shows as a picture of the docs."""
    page = folder / "terminal.html"
    page.write_text(html)
    photograph(page, target, element("pre"))


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


def pictures(*bags: Path) -> None:
    """Frames of the same instants, a row for each bag."""
    rows = [np.hstack(frames(one)) for one in bags]
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


def steps(folder: Path, recordings: Recordings, address: str) -> None:
    """The steps from a server to a report, as docs/carla.md has them."""
    camera = ("--camera", f"carla://{address}")
    shutil.copyfile(MAP, folder / "Town01.xodr")
    asked = ("doctor", "--carla", address, "--map", "Town01.xodr")
    probed = ("carla", "probe", address, "--out", "carla_probe.json")
    shown(folder, terminal(folder, address, asked, probed), "carla-probe.webp")
    k_star = recordings.k_star("cut_in")
    for one in (k_star, recordings.clip("cut_in")):
        shutil.copyfile(one, folder / one.name)
    compiling = (
        "compile",
        k_star.name,
        "--target",
        "sumo",
        "--map",
        "Town01.xodr",
        *BLOCK,
        "--out",
        "T",
    )
    running = ("run", "T", *camera, "--out", "R")
    shown(folder, terminal(folder, address, compiling, running), "carla-run.webp")

    run = folder / "R"
    shutil.copyfile(folder / "carla_probe.json", run / "carla_probe.json")
    synthetic, physical = folder / "synthetic", folder / "physical"
    shutil.copytree(recordings.get("cut_in", "synthetic"), synthetic)
    ours = ("--site", "north_track", "--in-process", "--record", "--out", physical)
    succeed("run", k_star, *ours)
    truth = recordings.folder / "cut_in.truth.json"
    succeed("labels", "new", synthetic, run, physical, "--truth", truth)
    terminal(folder, address, ("audit", "synthetic", "R", "physical", "--out", "audit"))
    photograph(
        folder / "audit" / "audit.html",
        "carla-audit.webp",
        element("section.refusal"),
        (row("scenery of CARLA"), row("body of ot1")),
    )
    bridge = ("--bridge", "constant_velocity", "--no-controls", "--out", folder / "scored")
    succeed("evaluate", run / "bag", "--propose-labels", *bridge)
    succeed("report", folder / "scored")
    photograph(folder / "scored" / "index.html", "carla-report.webp", element("ul.notices"))


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as name,
        Counterpart(Behaviour(xodr=MAP.read_text())) as server,
    ):
        folder, address = Path(name), server.address
        steps(folder, Recordings(folder / "recordings"), address)
        succeed("run", folder / "T", "--in-process", "--record", "--out", folder / "ours")
        # CARLA's client and its server need processes of their own.
        camera = f"carla://{address}"
        terminal(folder, address, ("draw", "ours", "--camera", camera, "--out", "drawn"))
        pictures(folder / "ours" / "bag", folder / "drawn")
        with Counterpart(Behaviour(xodr=MAP.read_text(), physics=WEAK)) as weak:
            moving = ("run", "T", "--plant", f"carla://{weak.address}", "--out", "moved")
            terminal(folder, weak.address, moving)
        motion(folder / "moved")


if __name__ == "__main__":
    main()
