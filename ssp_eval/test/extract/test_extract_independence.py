"""The extractor can't know labels: not by its interface, not by imports, not by what it leaves."""

from __future__ import annotations

import ast
import inspect
import json
import subprocess
import sys
from pathlib import Path

import ssp_eval.extract
from ssp_eval.data.records import Slots
from ssp_eval.evaluate.store import answer_records
from ssp_eval.extract import engine, extract
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.extract.measure import measure, parse_corpus

FOLDER = Path(ssp_eval.extract.__file__).parent
# What knows labels, scores, audits or recordings.
FORBIDDEN = (
    "ssp_eval.labels",
    "ssp_eval.score",
    "ssp_eval.evaluate",
    "ssp_eval.audit",
    "ssp_eval.report",
    "ssp_eval.package",
    "ssp_eval.demo",
    "ssp_core.bag",
    "ssp_scenario_manager",
    "ssp_vla_bridge",
)
# The parts of the rules, each behind those that it may import.
PARTS = (
    "asserted",
    "tokens",
    "lexicon",
    "match",
    "speaker",
    "scope",
    "world",
    "clause",
    "movement",
    "bind",
    "decide",
    "checks",
    "engine",
)
TEXTS = (
    "A car is ahead on the right and keeps its lane. We maintain speed and stay in our lane.",
    "The car is cutting in from the right. There is a risk of collision. We slow down.",
    "The car is on a collision course with us. We brake and stay in our lane.",
    "The car is ahead and no longer a risk. We accelerate.",
)


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
    code = "import ssp_eval.extract.combined.extractor as _, sys; print('\\n'.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True
    )
    loaded = done.stdout.splitlines()
    assert "ssp_eval.extract.bind" in loaded
    known = ("ssp_eval.labels", "ssp_eval.score", "ssp_eval.evaluate", "ssp_eval.audit")
    assert not [name for name in loaded if name.startswith(known)]


def test_a_part_of_the_rules_imports_none_that_stands_behind_it() -> None:
    for at, part in enumerate(PARTS):
        folder = FOLDER / part
        files = sorted(folder.glob("*.py")) if folder.is_dir() else [FOLDER / f"{part}.py"]
        known = {
            name.split(".")[2]
            for file in files
            for name in imports(file)
            if name.startswith("ssp_eval.extract.")
        }
        before = set(PARTS[: at + folder.is_dir()])
        assert known <= before, f"{part} imports {known - before}"


def test_the_hash_of_the_rules_covers_all_that_they_import() -> None:
    waiting, covered = [FOLDER / "engine.py"], set[str]()
    while waiting:
        file = waiting.pop()
        covered.add(file.relative_to(FOLDER).as_posix())
        for name in imports(file):
            if not name.startswith("ssp_eval.extract."):
                continue
            path = FOLDER.joinpath(*name.split(".")[2:-1]).with_suffix(".py")
            if path.is_file() and path.relative_to(FOLDER).as_posix() not in covered:
                waiting.append(path)
    assert len(covered) > 15
    assert covered <= set(engine._SOURCES)


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


def test_records_are_made_without_labels() -> None:
    """The functions that make a cell's records take answers, an adapter and an extractor."""
    for make in (answer_records.records_of, answer_records.record_of):
        assert not [name for name in inspect.signature(make).parameters if "label" in name]
    assert not {
        n for n in imports(Path(answer_records.__file__)) if n.startswith("ssp_eval.labels")
    }
