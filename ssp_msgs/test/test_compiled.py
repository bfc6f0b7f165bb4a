"""The compiled core: which modules are taken from it, and that sessions stay the same."""

import importlib.util
import json
import os
import shutil
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

from ssp_core.compiled import (
    OFF,
    RECIPE,
    TABLE,
    CompiledCore,
    CompiledFinder,
    core_in_use,
    hash_of,
    sources_of,
    state_of_core,
    use_compiled,
)
from ssp_core.errors import HostError
from ssp_core.files.folders import remove_folder

ROOT = Path(__file__).parents[2]
SOURCE = b"VALUE = 'interpreted'\n"


def made_by() -> dict[str, str]:
    return {"python": sys.version, "mypy": version("mypy"), "recipe": hash_of(RECIPE)}


@pytest.fixture
def core(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that holds ``probed.inner`` as if it were compiled, from a package on a path."""
    package = tmp_path / "path" / "probed"
    (package / "deep").mkdir(parents=True)
    for name in ("__init__.py", "inner.py", "deep/listed_nowhere.py"):
        (package / name).write_bytes(SOURCE)
    # As an editor leaves one where a file is open.
    (package / ".#inner.py").symlink_to("me@here.1234")
    folder = tmp_path / "core"
    folder.mkdir()
    (folder / "inner.py").write_text("VALUE = 'compiled'\n")
    table = {
        **made_by(),
        "files": {"probed.inner": "inner.py"},
        "sources": sources_of(package),
    }
    (folder / TABLE).write_text(json.dumps(table))
    monkeypatch.setattr("ssp_core.compiled.FOLDER", folder)
    monkeypatch.delenv(OFF, raising=False)
    return folder


def is_importable(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str = "probed.inner"
) -> bool:
    monkeypatch.setattr(sys, "path", [str(folder.parent / "path"), *sys.path])
    core = CompiledCore.read(folder)
    assert core is not None
    return CompiledFinder(core).find_spec(name, None) is not None


def test_a_module_is_compiled_while_its_source_is_what_was_compiled(
    core: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert is_importable(core, monkeypatch)
    assert state_of_core() == "sessions run compiled"
    assert not is_importable(core, monkeypatch, "probed.other")


@pytest.mark.parametrize("name", ["inner.py", "deep/listed_nowhere.py", "deep/added.py"])
def test_all_modules_are_interpreted_once_a_source_of_their_package_changed(
    core: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (core.parent / "path" / "probed" / name).write_bytes(SOURCE + b"# changed\n")
    assert not is_importable(core, monkeypatch)
    assert f"probed/{name} isn't what it was when the core was compiled" in state_of_core()


def test_all_modules_are_interpreted_once_a_source_of_their_package_is_gone(
    core: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (core.parent / "path" / "probed" / "deep" / "listed_nowhere.py").unlink()
    assert not is_importable(core, monkeypatch)
    assert "probed/deep/listed_nowhere.py isn't what it was" in state_of_core()


def test_a_half_removed_core_has_all_modules_interpreted(
    core: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = json.loads((core / TABLE).read_text())
    table["files"]["probed.deep"] = "deep.so"
    (core / TABLE).write_text(json.dumps(table))
    assert not is_importable(core, monkeypatch)
    assert "deep.so is missing" in state_of_core()
    (core / "deep.so").touch()
    known = CompiledCore.read(core)
    assert known is not None
    finder = CompiledFinder(known)
    assert finder.find_spec("probed.inner", None) is not None
    (core / "deep.so").unlink()
    assert finder.find_spec("probed.deep", None) is None


def test_a_folder_is_removed_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "core"
    folder.mkdir()
    (folder / TABLE).touch()
    seen = []

    def removed(path: Path, **_: bool) -> None:
        seen.append((folder.exists(), (path / TABLE).is_file()))

    monkeypatch.setattr(shutil, "rmtree", removed)
    remove_folder(folder)
    assert seen == [(False, True)]
    monkeypatch.undo()
    remove_folder(folder)
    assert len(os.listdir(tmp_path)) == 1


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("python", "3.99", "another Python"),
        ("mypy", "0.0.1", "mypy 0.0.1, which compiled it, isn't installed"),
        ("recipe", "0", "compile_core.py isn't the script that compiled it"),
    ],
)
def test_what_was_made_otherwise_runs_interpreted(
    core: Path, monkeypatch: pytest.MonkeyPatch, key: str, value: str, why: str
) -> None:
    table = json.loads((core / TABLE).read_text())
    (core / TABLE).write_text(json.dumps({**table, key: value}))
    assert not is_importable(core, monkeypatch)
    assert why in state_of_core()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"python": "3.11"}', '{"files": 1}'])
def test_a_broken_table_is_no_compiled_core(
    core: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.setattr(sys, "meta_path", before := list(sys.meta_path))
    (core / TABLE).write_text(text)
    use_compiled()
    assert sys.meta_path == before
    assert state_of_core().startswith("can't be read")


@pytest.mark.usefixtures("core")
def test_a_variable_leaves_the_compiled_core_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.setenv(OFF, "1")
    count = len(sys.meta_path)
    use_compiled()
    assert len(sys.meta_path) == count
    monkeypatch.delenv(OFF)
    use_compiled()
    assert len(sys.meta_path) == count + 1


def test_no_variable_names_another_core(
    core: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ssp_core.compiled.FOLDER", tmp_path / "none")
    for name in ("SSP_COMPILED", "SSP_COMPILED_CORE"):
        monkeypatch.setenv(name, str(core))
    monkeypatch.setattr(sys, "meta_path", before := list(sys.meta_path))
    use_compiled()
    assert sys.meta_path == before
    assert state_of_core().startswith("none")


def test_a_process_says_which_core_it_uses(core: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(core.parent / "path"), *sys.path])
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    assert core_in_use() is None
    use_compiled()
    assert core_in_use() == hash_of(core / TABLE)
    (core.parent / "path" / "probed" / "inner.py").write_bytes(SOURCE + b"# changed\n")
    assert core_in_use() == hash_of(core / TABLE), "modules of it were imported before"
    monkeypatch.setattr(sys, "meta_path", [one for one in sys.meta_path if not is_core(one)])
    use_compiled()
    assert core_in_use() is None


def is_core(finder: object) -> bool:
    return isinstance(finder, CompiledFinder)


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
        **made_by(),
        "files": {"ssp_core.clock": "clock.py"},
        "sources": sources_of(ROOT / "ssp_msgs" / "ssp_core"),
    }
    (tmp_path / TABLE).write_text(json.dumps(table))
    assert compile_core.sessions(["cut_in"], tmp_path) != interpreted


def test_no_module_of_the_core_caches_properties(compile_core: ModuleType) -> None:
    for package, names in compile_core.MODULES.items():
        for name in names:
            text = (ROOT / package / f"{name}.py").read_text()
            assert "cached_property" not in text, f"{name}: mypyc would compute it at each look"


@pytest.fixture
def place(tmp_path: Path, core: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A compiled core in its place, with the fixture's package on the path."""
    monkeypatch.setattr(sys, "path", [str(core.parent / "path"), *sys.path])
    return Path(shutil.copytree(core, tmp_path / "environment" / "ssp-compiled"))


def test_a_source_that_is_saved_while_it_is_compiled_is_refused(
    core: Path, place: Path, monkeypatch: pytest.MonkeyPatch, compile_core: ModuleType
) -> None:
    def copy(folder: Path) -> None:
        shutil.copytree(core, folder, dirs_exist_ok=True)

    def save(_: Path) -> list[str]:
        (core.parent / "path" / "probed" / "inner.py").write_bytes(SOURCE + b"# saved\n")
        return []

    monkeypatch.setattr(compile_core, "compile_to", copy)
    monkeypatch.setattr(compile_core, "differing", lambda _: [])
    compile_core.build(place)
    (place / "of_the_one_before").touch()
    monkeypatch.setattr(compile_core, "differing", save)
    with pytest.raises(HostError, match=r"isn't kept: probed/inner\.py isn't what it was"):
        compile_core.build(place)
    assert (place / "of_the_one_before").is_file()
    assert sorted(os.listdir(place.parent)) == ["ssp-compiled", "ssp-compiled.lock"]


def test_hashes_are_of_what_the_compiler_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compile_core: ModuleType
) -> None:
    source = tmp_path / "above" / "probed" / "inner.py"
    source.parent.mkdir(parents=True)
    source.write_bytes(SOURCE)

    class Compiler:
        include_dirs = ()

        def __init__(self, _: object) -> None: ...

        def get_command_obj(self, _: str) -> "Compiler":
            return self

        def ensure_finalized(self) -> None: ...

        def run(self) -> None:
            source.write_bytes(SOURCE + b"# saved\n")
            Path(self.build_lib).mkdir()

        build_lib = ""

    monkeypatch.setattr(compile_core, "ROOT", tmp_path)
    monkeypatch.setattr(compile_core, "mypycify", lambda *_, **__: [])
    monkeypatch.setattr(compile_core, "Distribution", Compiler)
    before = hash_of(source)
    compile_core.compile_to(tmp_path / "core", {"above/probed": ["inner"]})
    table = json.loads((tmp_path / "core" / TABLE).read_text())
    assert table["sources"] == {"probed/inner.py": before}
    assert table["recipe"] == hash_of(RECIPE)

    def fail(_: Compiler) -> None:
        raise compile_core.CCompilerError("command 'gcc' failed")

    monkeypatch.setattr(Compiler, "run", fail)
    with pytest.raises(HostError, match="apt install build-essential python3-dev"):
        compile_core.compile_to(tmp_path / "other", {"above/probed": ["inner"]})


def test_a_failure_is_one_line_and_leaves_what_was_there(
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    compile_core: ModuleType,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def compiled_twice(_: Path) -> None:
        compile_core.build(place)

    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(compile_core, "FOLDER", place)
    monkeypatch.setattr(compile_core, "compile_to", compiled_twice)
    assert compile_core.main() == 1
    assert capsys.readouterr().err == (
        "ssp build-core: another one compiles just now; wait until it has ended\n"
    )
    assert sorted(os.listdir(place.parent)) == ["ssp-compiled", "ssp-compiled.lock"]
    assert (place / TABLE).is_file()
    monkeypatch.setattr(compile_core, "_SESSIONS", "raise SystemExit(3)")
    with pytest.raises(HostError, match="the compiled sessions ended with status 3"):
        compile_core.sessions(["cut_in"], place)
