"""The harness of the mutation tests lays out what mutmut needs and reads what it says."""

import importlib.util
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

RUN = Path(__file__).parent / "run.py"


@pytest.fixture(scope="module")
def run():
    """tests/mutation/run.py."""
    spec = importlib.util.spec_from_file_location("mutation_run", RUN)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mutation")
    run.lay_out(folder)
    return folder


def pytest_in(folder, *arguments):
    """Runs tests of the laid out folder as mutmut does, with its package before ours."""
    path = os.pathsep.join([str(folder), *sys.path])
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def test_every_scoring_test_is_taken_but_that_of_imports(run):
    tests = (run.ROOT / "ssp_eval" / "test" / "score").glob("test_score_*.py")
    names = {path.stem.removeprefix("test_score_") for path in tests}
    assert names - {"imports"} == set(run.TESTS)


def test_all_that_is_left_out_exists(run):
    assert all((run.ROOT / "ssp_eval" / path).is_file() for path in run.LEFT_OUT)


def test_the_configuration_names_folders_that_are_there(run, folder):
    found = tomllib.loads((folder / "pyproject.toml").read_text())["tool"]["mutmut"]
    selection = found["pytest_add_cli_args_test_selection"]
    for path in (*found["source_paths"], *found["also_copy"], *selection):
        assert (folder / path).exists(), path
    assert found["do_not_mutate"] == list(run.LEFT_OUT)


def test_the_golden_cases_pass_there_and_see_a_changed_comparison(folder):
    assert pytest_in(folder, "tests/golden").returncode == 0
    source = folder / "ssp_eval" / "score" / "thresholds.py"
    whole = source.read_text()
    changed = whole.replace("value <= limit + self.tolerance", "value < limit - self.tolerance")
    assert changed != whole
    source.write_text(changed)
    try:
        done = pytest_in(folder, "-x", "tests/golden")
    finally:
        source.write_text(whole)
    assert done.returncode == 1, done.stdout
    assert "1 failed" in done.stdout


def test_what_mutmut_says_is_read(run):
    listing = """
    ssp_eval.score.metrics.x_ratio__mutmut_1: killed
    ssp_eval.score.metrics.x_ratio__mutmut_2: survived
    ssp_eval.score.engine.xǁScoresǁcells__mutmut_1: no tests
    a warning: of another kind
    """
    assert run.outcomes(listing) == {
        "ssp_eval.score.metrics.x_ratio__mutmut_1": "killed",
        "ssp_eval.score.metrics.x_ratio__mutmut_2": "survived",
        "ssp_eval.score.engine.xǁScoresǁcells__mutmut_1": "no tests",
    }


def test_without_mutmut_it_says_what_to_install(run, tmp_path, capsys):
    assert run.main([str(tmp_path / "work"), "--mutmut", "no-such-mutmut"]) == 2
    assert "pip install mutmut" in capsys.readouterr().err
    assert not (tmp_path / "work").exists()


def test_a_folder_of_something_else_is_left_alone(run, tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert run.main([str(tmp_path), "--mutmut", sys.executable]) == 2
    assert "name another" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
