"""The extractor can't know labels: not by its interface, not by imports, not by what it leaves."""

from __future__ import annotations

import ast
import inspect
import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

import ssp_eval.extract
from ssp_eval.data.labels import parse_labels
from ssp_eval.data.records import BehaviourRecord, Slots, load_records, record_to_json
from ssp_eval.evaluate import cell
from ssp_eval.extract import extract
from ssp_eval.extract.llm import Extractor
from ssp_eval.extract.measure import measure, parse_corpus
from ssp_eval.score.cell import score_cell

FOLDER = Path(ssp_eval.extract.__file__).parent
# What knows labels, scores, audits or recordings.
FORBIDDEN = (
    "ssp_eval.labels", "ssp_eval.score", "ssp_eval.evaluate", "ssp_eval.audit", "ssp_eval.report",
    "ssp_eval.package", "ssp_eval.demo", "ssp_core.bag", "ssp_scenario_manager", "ssp_vla_bridge",
)  # fmt: skip
# The parts of the rules, each behind those that it may import.
PARTS = ("tokens", "lexicon", "match", "scope", "world", "clause", "bind", "decide",
         "checks", "engine")  # fmt: skip
TEXTS = (
    "A car is ahead on the right and keeps its lane. We maintain speed and stay in our lane.",
    "The car is cutting in from the right. There is a risk of collision. We slow down.",
    "The car is on a collision course with us. We brake and stay in our lane.",
    "The car is ahead and no longer a risk. We accelerate.",
)
LABELS = [
    (["car"], "front_right", "same_direction", "no_conflict", "maintain", False),
    (["car"], "front_right", "cutting_in_from_right", "potential", "decelerate", True),
    (["car"], "front", "cutting_in_from_right", "active", "decelerate", True),
    (["car"], "front", "same_direction", "resolved", "accelerate", True),
]


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def test_the_interfaces_take_a_text_and_nothing_else() -> None:
    assert list(inspect.signature(extract).parameters) == ["text"]
    assert list(inspect.signature(Extractor.__call__).parameters) == ["self", "text"]


def test_nothing_that_knows_labels_is_imported() -> None:
    modules = sorted(FOLDER.rglob("*.py"))
    assert len(modules) > 20
    for path in modules:
        known = {name for name in imports(path) if name.startswith(FORBIDDEN)}
        assert not known, f"{path.relative_to(FOLDER)} imports {known}"


def test_nothing_that_knows_labels_is_imported_by_what_is_imported() -> None:
    code = "import ssp_eval.extract, ssp_eval.extract.llm, sys; print('\\n'.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True
    )
    loaded = done.stdout.splitlines()
    assert "ssp_eval.extract.bind" in loaded
    known = ("ssp_eval.labels", "ssp_eval.score", "ssp_eval.evaluate", "ssp_eval.audit")
    assert not [name for name in loaded if name.startswith(known)]


def test_a_part_of_the_rules_imports_none_that_stands_behind_it() -> None:
    for at, part in enumerate(PARTS):
        known = {name.split(".")[2] for name in imports(FOLDER / f"{part}.py")
                 if name.startswith("ssp_eval.extract.")}  # fmt: skip
        assert known <= set(PARTS[:at]), f"{part} imports {known - set(PARTS[:at])}"


def test_only_the_measure_and_the_review_read_slots_that_people_gave() -> None:
    for path in sorted(FOLDER.rglob("*.py")):
        if path.parent.name == "review" or path.name in ("measure.py", "tables.py", "cli.py"):
            continue
        known = {n for n in imports(path) if n.startswith("ssp_eval.extract.")}
        assert not {n for n in known if ".measure" in n or ".review" in n}, path


def test_the_measure_shows_the_extractor_only_the_text() -> None:
    """The same text labelled in two ways gives the same slots: the labels don't reach it."""
    seen: list[tuple[object, ...]] = []

    def spy(*given: object) -> Slots:
        seen.append(given)
        return extract(str(given[0]))

    slots = dict.fromkeys(("objects", "position", "motion", "conflict", "lat_action"))
    for value in ("stop", "maintain"):
        action = {"value": value, "evidence": [[0, 2]]}
        one = {"id": "a", "style": "coc", "text": TEXTS[1], "slots": slots | {"lon_action": action}}
        measure(parse_corpus(json.dumps(one), "memory"), spy)
    assert seen == [(TEXTS[1],), (TEXTS[1],)]


def records(order: list[int]) -> list[BehaviourRecord]:
    extractor = Extractor()
    return [
        BehaviourRecord(float(t), TEXTS[i], extractor(TEXTS[i]).slots) for t, i in enumerate(order)
    ]


def labels(order: list[int]) -> dict[str, object]:
    rows = []
    for t, i in enumerate(order):
        objects, position, motion, conflict, action, is_risky = LABELS[i]
        rows.append(
            {"t_s": float(t), "phase": "conflict", "risk_visible": is_risky, "objects": objects,
             "position": position, "motion": motion, "conflict": conflict,
             "lon_actions": [action], "lat_actions": ["straight"]}
        )  # fmt: skip
    return {
        "schema": "ssp.labels/1", "scenario": "cut_in", "domain": "simulation",
        "event_version": "sha256:" + "0" * 64, "risk_time_s": 0.0, "first_frame_dynamics": True,
        "labels": rows,
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_labels_that_change_after_extraction_change_no_byte_of_the_records(
    seed: int, tmp_path: Path
) -> None:
    path = tmp_path / "records.jsonl"
    order = list(range(len(TEXTS)))
    path.write_text("".join(record_to_json(one) + "\n" for one in records(order)), "utf-8")
    before = path.read_bytes()
    right = score_cell(parse_labels(labels(order), "memory"), load_records(path)).to_json()
    shuffled = order[1:] + order[:1]
    random.Random(seed).shuffle(shuffled)
    other = score_cell(parse_labels(labels(shuffled), "memory"), load_records(path)).to_json()
    again = "".join(record_to_json(one) + "\n" for one in records(order)).encode()
    assert path.read_bytes() == before == again
    if shuffled != order:
        assert other["sem_acc_eff"] < right["sem_acc_eff"]


@pytest.mark.parametrize("order", [[1, 0, 2, 3], [3, 2, 1, 0], [2, 3, 0, 1]])
def test_labels_and_records_permuted_alike_score_alike(order: list[int]) -> None:
    """Scores of single outputs; what depends on the order in time (risk, flow) is left out."""
    given = list(range(len(TEXTS)))
    plain = score_cell(parse_labels(labels(given), "memory"), records(given)).to_json()
    moved = score_cell(parse_labels(labels(order), "memory"), records(order)).to_json()
    for name in ("n", "jovr", "sem_cov", "sem_acc_cond", "sem_acc_eff", "sem_acc_soft",
                 "act_acc_eff"):  # fmt: skip
        assert moved[name] == pytest.approx(plain[name]), name
    assert plain["sem_cov"] > 0.5


def test_records_are_made_without_labels() -> None:
    """What makes the records of a cell takes answers, an adapter and an extractor."""
    for make in (cell.records_of, cell.record_of):
        assert not [name for name in inspect.signature(make).parameters if "label" in name]
    assert not {n for n in imports(Path(cell.__file__)) if n.startswith("ssp_eval.labels")}
