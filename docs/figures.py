"""Draws the pictures of docs/figures.md: ``python docs/figures.py [DEMO]``.

Matrix and slopes show made-up scores of made-up models; DEMO, the folder of ``ssp demo``, gives the
frames by phase.
"""

from __future__ import annotations

import csv
import random
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image

from ssp_core.cli import main
from ssp_core.vocabulary import DOMAINS
from ssp_eval.evaluate.clients.models import BEST_CONSTANT

IMAGES = Path(__file__).resolve().parent / "images"
SKILLS = {"model_a": 0.36, "model_b": 0.5, "model_c": 0.44, BEST_CONSTANT: 0.3}
SCORES = ("jovr", "sem_acc_eff", "cia_eff", "act_acc_eff", "tqsr", "atc_eff")
SPREAD = 0.2
SEED = 3
PHASES = "phases_cut_in_opencv_baseline"
WIDTH_PX, QUALITY = 946, 85


def made_up(file: Path) -> Path:
    """Write scores of each model for two scenarios in the three domains."""
    numbers = random.Random(SEED)
    with file.open("w", newline="", encoding="utf-8") as stream:
        lines = csv.writer(stream)
        lines.writerow(("scenario", "domain", "model", *SCORES, "risk"))
        for scenario in ("cut_in", "vru_crossing"):
            for domain in DOMAINS:
                for model, skill in SKILLS.items():
                    drawn = [min(1.0, max(0.0, numbers.gauss(skill, SPREAD))) for _ in SCORES]
                    responds = numbers.random() < skill
                    risk = f"S@{numbers.choice((0.5, 1.0, 1.5)):.2f}" if responds else "F"
                    lines.writerow((scenario, domain, model, *(f"{x:.4f}" for x in drawn), risk))
    return file


def draw(demo: Path | None) -> None:
    """Draw all pictures, those of a campaign only where one is given."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        scores = made_up(out / "scores.csv")
        command = ["report", "--from-cells", str(scores), "--figures", str(out)]
        main([*command, "--only", "matrix", "--only", "models"])
        shutil.copyfile(out / "matrix.svg", IMAGES / "figures-matrix.svg")
        shutil.copyfile(out / "models_ranks.svg", IMAGES / "figures-ranks.svg")
        if demo is None:
            return
        copy = out / "demo"
        shutil.copytree(demo, copy)
        command = ["report", str(copy), "--figures", str(out), "--only", "phases"]
        main([*command, "--resamples", "100"])
        with Image.open(out / f"{PHASES}.png") as picture:
            height = round(picture.height * WIDTH_PX / picture.width)
            shown = picture.convert("RGB").resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
            shown.save(IMAGES / "figures-phases.jpg", quality=QUALITY)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
