"""Draws the moving picture of the README: ``python docs/chain.py DEMO``, DEMO being ``ssp demo``'s.

Four scenes: the event, its three recordings with their trigger at the same instant, the audit, the
scores. Needs a browser for the pages.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
from PIL import Image, ImageDraw, ImageFont

from ssp_core.cli import main

DOCS = Path(__file__).resolve().parent
SIZE = (960, 520)
TITLE_HEIGHT = 56
RATE_HZ = 5
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
INK, PAPER = (31, 41, 51), (255, 255, 255)


def font(size: int, name: str = "DejaVuSans") -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(FONTS / f"{name}.ttf"), size)


def canvas(number: int, title: str) -> Image.Image:
    """Draw an empty scene with its title."""
    image = Image.new("RGB", SIZE, PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((24, 14), f"{number}", font=font(24, "DejaVuSans-Bold"), fill=(176, 60, 20))
    draw.text((56, 14), title, font=font(24), fill=INK)
    return image


def page(source: Path, width: int, height: int) -> Image.Image:
    """Take a picture of a page or drawing in a headless browser."""
    browser = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "page.png"
        command = [browser, "--headless", "--no-sandbox", "--hide-scrollbars", "--disable-gpu"]
        command += [f"--window-size={width},{height}", f"--screenshot={file}", source.as_uri()]
        subprocess.run(command, check=True, capture_output=True)
        return Image.open(file).convert("RGB")


def still(number: int, title: str, source: Path, width: int, top: int = 0) -> Image.Image:
    """Show a page under a title, scaled to the width of the scene, from ``top`` pixels on."""
    image = canvas(number, title)
    shown = page(source, width, top + round(width * SIZE[1] / SIZE[0]))
    shown = shown.crop((0, top, width, shown.height))
    height = round(shown.height * SIZE[0] / width)
    image.paste(shown.resize((SIZE[0], height), Image.Resampling.LANCZOS), (0, TITLE_HEIGHT))
    return image


def frames_of(recording: Path, folder: Path) -> list[tuple[float, Path]]:
    """Export the frames of a recording; their times in s by its clock."""
    assert main(["bag", "export", str(recording), "--frames", "jpg", "-o", str(folder)]) == 0
    files = sorted(folder.rglob("*.jpg"))
    return [(int(file.stem.split("_")[1]) * 1e-9, file) for file in files]


def three_recordings(demo: Path) -> list[Image.Image]:
    """Show the domains side by side, each with its trigger at the same instant."""
    audit = json.loads((demo / "audits" / "cut_in" / "audit.json").read_text())
    triggers = {r["domain"]: r["phases"]["trigger_s"] for r in audit["recordings"]}
    scenes = []
    with tempfile.TemporaryDirectory() as folder:
        shown = {
            domain: frames_of(demo / "runs" / f"cut_in-{domain}" / "bag", Path(folder) / domain)
            for domain in triggers
        }
        for step in range(-2 * RATE_HZ, 4 * RATE_HZ):
            image = canvas(2, "recorded in three domains")
            draw = ImageDraw.Draw(image)
            for column, (domain, frames) in enumerate(shown.items()):
                wanted = triggers[domain] + step / RATE_HZ
                file = min(frames, key=lambda frame: abs(frame[0] - wanted))[1]
                width = (SIZE[0] - 4 * 12) // 3
                picture = Image.open(file).convert("RGB")
                height = round(width * picture.height / picture.width)
                place = (12 + column * (width + 12), 150)
                image.paste(picture.resize((width, height), Image.Resampling.LANCZOS), place)
                name = f"{domain} (stand-in)" if domain == "physical" else domain
                draw.text((place[0], 118), name, font=font(18), fill=INK)
            when = f"{step / RATE_HZ:+.1f} s from the trigger"
            draw.text((12, 380), when, font=font(18), fill=(82, 96, 109))
            scenes.append(image)
    return scenes


def draw_chain(demo: Path, out: Path) -> None:
    event = still(1, "one event, specified once", DOCS / "images" / "cut_in.svg", 1240)
    films = three_recordings(demo)
    audit = still(3, "audited to be the same event", demo / "audits/cut_in/audit.html", 1200, 48)
    scores = still(4, "and only then compared", demo / "index.html", 1200, 700)
    images = [event, *films, audit, scores]
    lasting_ms = [2500, *[1000 // RATE_HZ] * len(films), 3000, 4000]
    images[0].save(
        out,
        save_all=True,
        append_images=images[1:],
        duration=lasting_ms,
        loop=0,
        quality=70,
        method=4,
    )


if __name__ == "__main__":
    draw_chain(Path(sys.argv[1]).resolve(), DOCS / "images" / "chain.webp")
