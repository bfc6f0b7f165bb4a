"""The extraction's rules on texts of a hundred words, beside a bare pass that finds the words."""

from __future__ import annotations

import json
import random
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from measure import cost, report

from ssp_eval.extract import extract
from ssp_eval.extract.combined.extractor import Extractor

TEXTS = 400
WORDS = 100
ROUNDS = 7
MOST = 35.0  # times the bare scan
_WORD = re.compile(r"[A-Za-z]+|[0-9.]+|[^\w\s]")

SCENE = (
    "The scene shows a two-lane urban road in daylight with dry asphalt and light traffic.",
    "Trees and parked cars line the street, and the sky is slightly overcast at this hour.",
    "A bus stop and a zebra crossing can be seen some way down the road.",
    "The traffic light ahead is green, and the lane markings are clear.",
)
OBJECTS = (
    "A white van is ahead on the right and is drifting into our lane from the right.",
    "A pedestrian stands on the left sidewalk, looks at a phone and doesn't affect our path.",
    "The cyclist who had been crossing from the left has already cleared our lane.",
    "If the truck behind us were to overtake, it might come close to the oncoming motorcycle.",
)
PLAN = (
    "There is a risk of collision with it if nothing changes in the next few seconds.",
    "The ego vehicle should slow down gently and stay in its lane to keep a safe gap.",
    "We should not accelerate, and changing lanes is ruled out because of oncoming traffic.",
    "- **Longitudinal:** decelerate\n- **Lateral:** keep lane\n",
)


def texts() -> list[str]:
    """Texts of scene, objects and plan, each a hundred words long and unlike the others."""
    rng = random.Random(11)
    made = []
    while len(made) < TEXTS:
        parts = [one for group in (SCENE, OBJECTS, PLAN) for one in rng.sample(group, 3)]
        made.append(" ".join(" ".join(parts).split(" ")[:WORDS]))
    return made


def per_second(read: Callable[[str], object], batch: list[str]) -> float:
    """Texts per second of processor time, in the best of several rounds."""
    best = min(_seconds(read, batch) for _ in range(ROUNDS))
    return len(batch) / best


def _seconds(read: Callable[[str], object], batch: list[str]) -> float:
    started = time.process_time()
    for one in batch:
        read(one)
    return time.process_time() - started


def command_per_second(batch: list[str], few: int = 300, many: int = 3000) -> float:
    """Texts per second of processor time through the command, without its start."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "texts.jsonl"

        def took_s(count: int) -> float:
            lines = (json.dumps({"id": k, "text": batch[k % len(batch)]}) for k in range(count))
            file.write_text("\n".join(lines) + "\n")
            return cost(["extract", str(file)])[0]

        return (many - few) / (took_s(many) - took_s(few))


def main() -> None:
    batch = texts()
    report(
        "extraction: ssp extract, with the language",
        command_per_second(batch),
        None,
        "texts/s",
        f"texts of {WORDS} words, read as JSON, their language told, rules, written as JSON",
        lower=False,
    )
    words = sum(len(one.split()) for one in batch) / len(batch)
    filled = sum(slot is not None for one in batch for slot in vars(extract(one)).values())
    report(
        "extraction: rules alone, one core",
        per_second(extract, batch),
        per_second(lambda one: [found.span() for found in _WORD.finditer(one)], batch),
        "texts/s",
        f"{TEXTS} texts of {words:.0f} words, {filled / len(batch):.1f} slots filled; bound: one "
        "pass of a regular expression that finds the words with their places",
        lower=False,
        ratio_limit=MOST,
    )
    extractor = Extractor()
    report(
        "extraction: rules and learned reader, one core",
        per_second(extractor, batch),
        per_second(extract, batch),
        "texts/s",
        "the same texts; bound: the rules alone",
        lower=False,
    )


if __name__ == "__main__":
    main()
