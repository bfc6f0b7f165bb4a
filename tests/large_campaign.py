"""A campaign of any size, cloned from a small real one under other names.

Cells are real cell files: only names, and in some of the variants what was said, are changed; the
stored score and the hashes are those of the changed files, so that nothing in a report is odd.
"""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, product
from pathlib import Path
from typing import Any

from ssp_core.files.writing import write_json, write_text
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import DOMAINS
from ssp_eval.data.labels import load_labels
from ssp_eval.data.records import load_records
from ssp_eval.evaluate.clients.models import CONDITIONS
from ssp_eval.evaluate.store.cell_file import (
    CELL_FILE,
    CELLS,
    FRAMES,
    LABELS_FILE,
    RAW_FILE,
    RECORDS_FILE,
    REQUESTS_FILE,
    SCORE_FILE,
    sealed,
)
from ssp_eval.score.cell import score_cell
from ssp_eval.statistics.tables.scores import condition_of

# With each of them asked under two conditions, and one answerer, sixteen names.
MODELS = tuple(f"model_{k:02d}" for k in range(5))
NAMES = (*MODELS, *(f"{name}+{one}" for name in MODELS for one in CONDITIONS), "perfect")
VARIANTS = 24
# One cell in this many is refused, and one failed.
_REFUSED_EVERY, _FAILED_EVERY = 97, 89


@dataclass(frozen=True)
class _Variant:
    """Files of a cell by name, and its cell.json."""

    files: dict[str, bytes]
    facts: dict[str, Any]


def clone_campaign(source: Path, out: Path, cells: int, seed: int = 1) -> None:
    """Writes a campaign of so many cells.

    Args:
        source: campaign folder with at least one scored cell.
        out: folder to make.
        cells: how many; five models and eleven controls in three domains of as many scenarios as
            that takes.
        seed: of what differs between the variants.
    """
    shutil.copytree(source / FRAMES, out / FRAMES)
    variants = list(_variants(source, out / "variants", random.Random(seed)))
    shutil.rmtree(out / "variants")
    for number, (scenario, domain, model) in enumerate(islice(_names(cells), cells)):
        _write(out, variants[number * 7 % len(variants)], (scenario, domain, model), number)


def _names(cells: int) -> Iterator[tuple[str, str, str]]:
    scenarios = [f"event_{k:03d}" for k in range(-(-cells // (len(NAMES) * len(DOMAINS))))]
    return product(scenarios, DOMAINS, NAMES)


def _variants(source: Path, scratch: Path, rng: random.Random) -> Iterator[_Variant]:
    folders = sorted(file.parent for file in (source / CELLS).glob(f"*/{CELL_FILE}"))
    folders = [folder for folder in folders if (folder / SCORE_FILE).is_file()]
    for number in range(VARIANTS):
        folder = folders[number % len(folders)]
        work = scratch / str(number)
        shutil.copytree(folder, work)
        lines = [json.loads(line) for line in (work / RECORDS_FILE).read_text().splitlines()]
        for record in lines:
            for name in record["slots"]:
                if rng.random() < number / (3 * VARIANTS):
                    record["slots"][name] = None
            if rng.random() < number / (6 * VARIANTS):
                record["trajectory"], record["invalid"] = None, ["missing"]
        write_text(work / RECORDS_FILE, "".join(json.dumps(line) + "\n" for line in lines))
        score = score_cell(load_labels(work / LABELS_FILE), load_records(work / RECORDS_FILE))
        write_json(work / SCORE_FILE, score.to_json())
        facts = json.loads((work / CELL_FILE).read_text())
        names = (LABELS_FILE, RAW_FILE, REQUESTS_FILE, RECORDS_FILE, SCORE_FILE)
        facts["hashes"] |= {(work / name).stem: sha256_file(work / name) for name in names}
        yield _Variant({name: (work / name).read_bytes() for name in names}, facts)


def _write(out: Path, variant: _Variant, name: tuple[str, str, str], number: int) -> None:
    scenario, domain, model = name
    folder = out / CELLS / "__".join(name)
    folder.mkdir(parents=True)
    facts = {**variant.facts, "scenario": scenario, "domain": domain, "model": model}
    facts["backend"] = model if model == "perfect" else "python"
    condition = condition_of(model)[1]
    facts |= {"control": model not in MODELS, "condition": condition}
    files = dict(variant.files)
    if number % _REFUSED_EVERY == _REFUSED_EVERY - 1:
        facts |= {"status": "refused", "reasons": ["the run's verdict is aborted: link lost"]}
    elif number % _FAILED_EVERY == _FAILED_EVERY - 1:
        facts |= {"status": "failed", "reasons": ["bridge died: killed by SIGKILL"]}
    if facts["status"] != "ok":
        del files[SCORE_FILE]
    labels = json.loads(files[LABELS_FILE])
    write_json(folder / LABELS_FILE, {**labels, "scenario": scenario, "domain": domain})
    for file, data in files.items():
        if file != LABELS_FILE:
            (folder / file).write_bytes(data)
    hashes = {**facts["hashes"], "labels": sha256_file(folder / LABELS_FILE)}
    if SCORE_FILE not in files:
        del hashes["score"]
    facts["hashes"] = hashes
    write_json(folder / CELL_FILE, sealed(facts))
