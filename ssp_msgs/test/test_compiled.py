"""The compiled core: which modules are taken from it, and that sessions stay the same."""

import hashlib
import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from ssp_core.compiled import OFF, TABLE, CompiledCore, CompiledFinder, state_of_core, use_compiled

ROOT = Path(__file__).parents[2]
SOURCE = b"VALUE = 'interpreted'\n"


@pytest.fixture
def core(tmp_path: Path) -> Path:
    """A folder that holds ``probed.inner`` as if it were compiled, from a source on a path."""
    (tmp_path / "path" / "probed").mkdir(parents=True)
    (tmp_path / "path" / "probed" / "inner.py").write_bytes(SOURCE)
    folder = tmp_path / "core"
    folder.mkdir()
    (folder / "inner.py").write_text("VALUE = 'compiled'\n")
    table = {
        "python": sys.version,
        "files": {"probed.inner": "inner.py"},
        "sources": {"probed/inner.py": hashlib.sha256(SOURCE).hexdigest()},
    }
    (folder / TABLE).write_text(json.dumps(table))
    return folder


def found(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str = "probed.inner") -> bool:
    monkeypatch.setattr(sys, "path", [str(folder.parent / "path"), *sys.path])
    core = CompiledCore.read(folder)
    assert core is not None
    return CompiledFinder(core).find_spec(name, None) is not None


def test_a_module_is_compiled_while_its_source_is_what_was_compiled(
    core: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(OFF)
    assert found(core, monkeypatch)
    assert state_of_core(core) == "sessions run compiled"
    assert not found(core, monkeypatch, "probed.other")


def test_all_modules_are_interpreted_once_one_source_changed(
    core: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(OFF)
    (core.parent / "path" / "probed" / "inner.py").write_bytes(SOURCE + b"# changed\n")
    assert not found(core, monkeypatch)
    assert "probed/inner.py isn't the source that was compiled" in state_of_core(core)


def test_another_python_runs_interpreted(core: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(OFF)
    table = json.loads((core / TABLE).read_text())
    (core / TABLE).write_text(json.dumps({**table, "python": "3.99"}))
    assert not found(core, monkeypatch)
    assert "another Python" in state_of_core(core)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"python": "3.11"}', '{"files": 1}'])
def test_a_broken_table_is_no_compiled_core(
    core: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.delenv(OFF)
    monkeypatch.setattr(sys, "meta_path", before := list(sys.meta_path))
    (core / TABLE).write_text(text)
    use_compiled(core)
    assert sys.meta_path == before
    assert state_of_core(core).startswith("can't be read")


def test_a_variable_leaves_the_compiled_core_out(
    core: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.setenv(OFF, "1")
    count = len(sys.meta_path)
    use_compiled(core)
    assert len(sys.meta_path) == count
    monkeypatch.delenv(OFF)
    use_compiled(core)
    assert len(sys.meta_path) == count + 1


@pytest.fixture(scope="module")
def compile_core() -> ModuleType:
    place = ROOT / "bootstrap" / "compile_core.py"
    spec = importlib.util.spec_from_file_location("compile_core", place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def interpreted(compile_core: ModuleType) -> list[str]:
    lines: list[str] = compile_core.sessions(["cut_in"])
    return lines


@pytest.mark.programs
def test_a_session_has_the_same_bytes_compiled(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    compile_core: ModuleType,
    interpreted: list[str],
) -> None:
    monkeypatch.chdir(ROOT)
    folder = tmp_path / "core"
    # One that imports nothing: the compiler looks at what a module imports, too.
    compile_core.compile_to(folder, {"ssp_msgs/ssp_core": ["clock"]})
    core = CompiledCore.read(folder)
    assert core is not None
    assert core.files["ssp_core.clock"].suffix == ".so"
    assert core.stale(sys.path) == ""
    assert compile_core.sessions(["cut_in"], folder) == interpreted


def test_a_core_that_changes_the_bytes_of_a_session_is_found(
    tmp_path: Path, compile_core: ModuleType, interpreted: list[str]
) -> None:
    source = ROOT / "ssp_msgs" / "ssp_core" / "clock.py"
    text = source.read_text()
    changed = text.replace("return ns / NS_PER_S", "return ns * (1.0 + 1e-15) / NS_PER_S")
    assert changed != text
    (tmp_path / "clock.py").write_text(changed)
    table = {
        "python": sys.version,
        "files": {"ssp_core.clock": "clock.py"},
        "sources": {"ssp_core/clock.py": hashlib.sha256(source.read_bytes()).hexdigest()},
    }
    (tmp_path / TABLE).write_text(json.dumps(table))
    assert compile_core.sessions(["cut_in"], tmp_path) != interpreted


def test_no_module_of_the_core_caches_properties(compile_core: ModuleType) -> None:
    for package, names in compile_core.MODULES.items():
        for name in names:
            text = (ROOT / package / f"{name}.py").read_text()
            assert "cached_property" not in text, f"{name}: mypyc would compute it at each look"
