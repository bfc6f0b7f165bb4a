"""Documents that are made from tables in the code say what the code says."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from ssp_core.run_file.model import Limits
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.liveness import SILENCES
from ssp_core.vocabulary import ControlState, SessionPhase

ROOT = Path(__file__).resolve().parents[2]
BY_NAME = {meaning.limit_name: code for code, meaning in MEANINGS.items()}
# A shared predicate that stands for two events, and those that judge a row of states.
MORE = {
    "separation": {SafetyCode.SEPARATION, SafetyCode.COLLISION},
    "stamp_ahead": {SafetyCode.CLOCK_OFFSET},
    "link_violations": {SafetyCode.LINK_DELAY, SafetyCode.CLOCK_OFFSET},
    "statement_violations": {
        SafetyCode.LOCALISATION,
        SafetyCode.OVER_ACCELERATION,
        SafetyCode.ERROR_LONGITUDINAL,
        SafetyCode.ERROR_LATERAL,
        SafetyCode.ERROR_YAW,
    },
    "follow": {SafetyCode.POSITION_JUMP, SafetyCode.STATE_FROZEN},
}


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_generate", ROOT / "docs" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_state_machines_are_those_of_the_tables(generate: ModuleType) -> None:
    written = (ROOT / "docs" / "state-machines.md").read_text()
    assert written == generate.state_machines(), "run `python docs/generate.py`"


def test_the_picture_of_a_test_objects_states_is_that_of_the_tables(generate: ModuleType) -> None:
    written = (ROOT / "docs" / "images" / "iso-22133-states.svg").read_text()
    assert written == generate.iso_states(), "run `python docs/generate.py`"
    # What it says in words and not by an arrow.
    assert "HEAB abort: from every state but INIT to ABORTING" in written
    assert "connection or heartbeats lost: from every state to INIT" in written


def test_the_parameters_are_those_of_the_tables(generate: ModuleType) -> None:
    assert (ROOT / "docs" / "parameters.md").read_text() == generate.parameters()
    files = generate.parameter_files()
    assert set(files) == set(ROOT.glob("ssp_*/config/*.param.yaml"))
    for path, text in files.items():
        assert path.read_text() == text, "run `python docs/generate.py`"


def test_the_marked_tables_are_those_of_the_code(generate: ModuleType) -> None:
    found = []
    for name in generate.MARKED:
        written = (ROOT / "docs" / name).read_text()
        assert written == generate.with_tables(written), "run `python docs/generate.py`"
        found += re.findall(r"<!-- table: (\w+) -->", written)
    assert sorted(found) == sorted(generate.BLOCKS)


def test_every_state_is_drawn_and_tabled(generate: ModuleType) -> None:
    text = generate.state_machines()
    for states in (SessionPhase, ControlState):
        for state in states:
            if state is not SessionPhase.UNKNOWN:
                assert f"| {state.value} {state.name} |" in text
                assert re.search(rf"{state.name} --> (ABORTING|ABORTED): .*(abort|ABORT)", text)


def test_every_event_has_a_row_with_a_limit_that_exists(generate: ModuleType) -> None:
    assert set(generate.JUDGED) == set(SafetyCode)
    named = [words for words, _ in generate.JUDGED.values() if words.endswith(("_s", "_m", "_mps"))]
    assert set(named) - {"end.at_latest_s"} <= set(Limits.model_fields)


def judged_in(*files: Path) -> set[SafetyCode]:
    """Events that the source of some modules judges: by shared predicates, or by their code."""
    found: set[SafetyCode] = set()
    for file in files:
        source = file.read_text()
        for predicate in re.findall(r"\b(?:judge\.)?(\w+)\(", source):
            found |= MORE.get(predicate, set())
            if predicate in BY_NAME:
                found.add(BY_NAME[predicate])
        made = re.findall(
            r"(?:(?:Passed|Violation|silent|unheard|too_many)\(\s*)SafetyCode\.(\w+)",
            source,
        )
        found |= {SafetyCode[word] for word in made}
    return found


def test_who_judges_what(generate: ModuleType) -> None:
    """A limit that moves to the other side, or is new there, must move in the table too."""
    objects = ROOT / "ssp_ot_controller" / "ssp_ot_controller"
    manager = ROOT / "ssp_scenario_manager" / "ssp_scenario_manager" / "session"
    gateway = objects / "bodies" / "iso22133"
    by_objects = judged_in(*(objects / "objects").glob("*.py"), *gateway.glob("*.py"))
    # A person's abort, which the manager writes down.
    passed_on = {SafetyCode.OPERATOR}
    by_manager = (SILENCES | judged_in(*manager.glob("*.py"))) - passed_on
    told = {
        side: {code for code, (_, judges) in generate.JUDGED.items() if side in judges}
        for side in (generate.OBJECT, generate.MANAGER)
    }
    assert told[generate.OBJECT] == by_objects
    assert told[generate.MANAGER] == by_manager
