"""Scoring of 10,000 cells beside the plain per-record scorer of naive_scorer.py (METHOD 6).

From columns, from records as objects, from the files of a campaign, and cell by cell with every
judgement.
"""

from __future__ import annotations

import gc
import json
import math
import random
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import naive_scorer
from measure import report

from ssp_core.vocabulary import CONFLICTS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_eval.data.labels import Label, Labels, labels_to_json
from ssp_eval.data.records import SLOT_NAMES, BehaviourRecord, Slot, Slots, record_to_json
from ssp_eval.score.cell import score_cell
from ssp_eval.score.columns import encode, load_columns
from ssp_eval.score.engine import Scores, score_columns
from ssp_vla_bridge.trajectory import Trajectory

CELLS = 10_000
# Each clip is answered by so many models, and each of these cells has a copy of its labels.
MODELS = 100
LABELS = 9
STEP_S = 0.5
POINTS = 11
ROUNDS = 5
TEXT = "A car is merging from the right in front of us, so I will slow down and keep my lane."

Cell = tuple[Labels, tuple[BehaviourRecord, ...]]


def a_label(rng: random.Random, j: int) -> Label:
    return Label(
        t_s=STEP_S * j,
        phase="conflict",
        risk_visible=j >= 4,
        objects=tuple(rng.sample(OBJECTS, rng.randint(0, 2))),
        position=rng.choice(POSITIONS),
        motion=rng.choice(MOTIONS),
        conflict=rng.choice((*CONFLICTS, None)),
        lon_actions=tuple(rng.sample(LON_ACTIONS, 2)),
        lat_actions=("straight",),
    )


def a_record(rng: random.Random, label: Label) -> BehaviourRecord:
    """An output that is right in most, lacks a tenth of the slots, and drives for five seconds."""

    def slot(value: Any, others: tuple[str, ...]) -> Slot | None:
        if value is None or rng.random() < 0.1:
            return None
        start = rng.randrange(0, 60)
        said = value if rng.random() < 0.7 else rng.choice(others)
        return Slot(said, ((start, start + 9),))

    speed_mps, x_m = rng.uniform(0, 15), [0.0]
    for _ in range(POINTS - 1):
        speed_mps = max(0.0, speed_mps + rng.uniform(-2, 2))
        x_m.append(x_m[-1] + speed_mps * STEP_S)
    return BehaviourRecord(
        t_s=label.t_s + rng.uniform(-0.05, 0.09),
        text=TEXT + str(rng.random()),
        slots=Slots(
            slot(label.objects, ((),)),
            slot(label.position, POSITIONS),
            slot(label.motion, MOTIONS),
            slot(label.conflict, CONFLICTS),
            slot(label.lon_actions[0], LON_ACTIONS),
            slot("straight", ("left",)),
        ),
        trajectory=Trajectory(
            tuple(STEP_S * k for k in range(POINTS)), tuple(x_m), (0.0,) * POINTS
        ),
    )


def a_cell(rng: random.Random) -> Cell:
    """Nine labels and as many outputs; nothing is shared between cells."""
    labels = tuple(a_label(rng, j) for j in range(LABELS))
    records = tuple(a_record(rng, label) for label in labels)
    return Labels("cut_in", "physical", "v", 2.0, False, labels), records


def best_s(call: Callable[[], object]) -> float:
    """Processor time of the fastest of several rounds, which disturbances touch least."""
    times = []
    for _ in range(ROUNDS):
        gc.collect()
        begun = time.process_time()
        call()
        times.append(time.process_time() - begun)
    return min(times)


def a_campaign(rng: random.Random, folder: Path) -> list[tuple[Path, Path]]:
    """Labels file and records file of as many cells, as `ssp evaluate` writes them."""
    files = []
    for number in range(CELLS):
        if number % MODELS == 0:
            labels, _ = a_cell(rng)
            written = json.dumps(labels_to_json(labels), indent=1)
        cell = folder / str(number)
        cell.mkdir()
        paths = cell / "labels.json", cell / "records.jsonl"
        paths[0].write_text(written)
        records = (a_record(rng, label) for label in labels.labels)
        paths[1].write_text("".join(f"{record_to_json(record)}\n" for record in records))
        files.append(paths)
    return files


def plain_load(labels: Path, records: Path) -> Cell:
    """Load files as a program does that trusts them: their JSON as the objects that it scores."""
    value = json.loads(labels.read_text())
    rest = {key: value[key] for key in value if key not in ("schema", "labels")}
    lines = records.read_text().splitlines()
    return (
        Labels(**rest, labels=tuple(Label(**label) for label in value["labels"])),
        tuple(plain_record(json.loads(line)) for line in lines),
    )


def plain_record(value: dict[str, Any]) -> BehaviourRecord:
    """The fields that the plain scorer reads."""
    slots = [value["slots"][name] for name in SLOT_NAMES]
    return BehaviourRecord(
        value["t_s"],
        value["text"],
        Slots(*[slot and Slot(slot["value"], slot["evidence"]) for slot in slots]),
        value["trajectory"] and Trajectory(**value["trajectory"]),
    )


def check(plain_scores: Iterable[dict[str, Any]], scores: Scores) -> None:
    """Every key of METHOD 6.14 of every cell agrees with the plain scorer to 1e-12."""
    for plain, ours in zip(plain_scores, scores.cells(), strict=True):
        for key, value in ours.to_json().items():
            same = value == plain[key] or (
                value is not None
                and plain[key] is not None
                and math.isclose(value, plain[key], rel_tol=0, abs_tol=1e-12)
            )
            if not same:
                raise SystemExit(f"{key}: {value!r} here, {plain[key]!r} by the plain scorer")


def main() -> None:
    rng = random.Random(1)
    cells = [a_cell(rng) for _ in range(CELLS)]
    columns = encode(cells)
    check((naive_scorer.score(*cell) for cell in cells), score_columns(columns))

    plain_s = best_s(lambda: [naive_scorer.score(*cell) for cell in cells])
    scoring_s = best_s(lambda: score_columns(columns))
    whole_s = best_s(lambda: score_columns(encode(cells)).cells())
    some = cells[: CELLS // 10]
    some_plain_s = best_s(lambda: [naive_scorer.score(*cell) for cell in some])
    alone_s = best_s(lambda: [score_cell(*cell) for cell in some])
    note = f"{CELLS} cells of {LABELS} records; bound: plain Python, record by record"
    report(
        "scoring: cells in columns",
        scoring_s,
        plain_s,
        "s",
        f"{note}; {plain_s / scoring_s:.0f} times as fast",
        lower=True,
        ratio_limit=1 / 20,
    )
    report(
        "scoring: cells as objects",
        whole_s,
        plain_s,
        "s",
        f"with turning objects into columns and back; {plain_s / whole_s:.1f} times as fast",
        lower=True,
    )
    report(
        "scoring: cell by cell, with every judgement",
        alone_s,
        some_plain_s,
        "s",
        f"{len(some)} cells, what the reports use; bound: the plain scorer, which keeps no reasons",
        lower=True,
    )


def from_files(rng: random.Random, folder: Path) -> None:
    """Measure the way from the files of a campaign to scores, as `ssp score` goes it."""
    files = a_campaign(rng, folder)

    def plain() -> Iterable[dict[str, Any]]:
        return (naive_scorer.score(*plain_load(*paths)) for paths in files)

    check(plain(), score_columns(load_columns(files)))
    plain_s = best_s(lambda: list(plain()))
    files_s = best_s(lambda: score_columns(load_columns(files)).cells())
    report(
        "scoring: cells in files",
        files_s,
        plain_s,
        "s",
        f"{CELLS} cells, {MODELS} to a clip; bound: json.loads, the same objects without a check, "
        f"and the plain scorer; {plain_s / files_s:.1f} times as fast",
        lower=True,
    )


if __name__ == "__main__":
    main()
    with tempfile.TemporaryDirectory() as folder:
        from_files(random.Random(2), Path(folder))
