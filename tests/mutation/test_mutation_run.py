"""The harness of the mutation tests lays out what mutmut needs and reads what it says."""

import os
import subprocess
import sys
import tomllib

import pytest

from tests.mutation import run


@pytest.fixture(scope="module")
def laid_out(tmp_path_factory):
    """The folders of all targets, by name."""
    folders = {name: tmp_path_factory.mktemp(name) for name in run.TARGETS}
    for name, folder in folders.items():
        run.lay_out(run.TARGETS[name], folder)
    return folders


def pytest_in(folder, *arguments):
    """Runs tests of the laid out folder as mutmut does, with its package before ours."""
    settings = tomllib.loads((run.ROOT / "pyproject.toml").read_text())["tool"]["pytest"]
    ours = {str(run.ROOT / each) for each in settings["ini_options"]["pythonpath"]}
    path = os.pathsep.join([str(folder), *(each for each in sys.path if each not in ours)])
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def test_every_pattern_of_tests_finds_some_and_every_file_that_is_left_out_exists():
    for name, target in run.TARGETS.items():
        assert all(any(run.ROOT.glob(pattern)) for pattern in target.tests), name
        assert all((run.ROOT / target.source / file).is_file() for file in target.left_out), name


def test_the_configurations_name_what_is_there(laid_out):
    for name, folder in laid_out.items():
        read = tomllib.loads((folder / "pyproject.toml").read_text())
        found = read["tool"]["mutmut"]
        selection = found["pytest_add_cli_args_test_selection"]
        paths = (*found["source_paths"], *found["also_copy"], *found["do_not_mutate"], *selection)
        for path in (*paths, *read["tool"]["pytest"]["ini_options"]["pythonpath"]):
            assert (folder / path).exists(), (name, path)


@pytest.mark.parametrize(
    ("name", "tests", "file", "old", "new"),
    [
        (
            "score",
            "tests/golden",
            "ssp_eval/score/thresholds.py",
            "value <= limit + self.tolerance",
            "value < limit - self.tolerance",
        ),
        (
            "safety",
            "tests_of_ssp_msgs/test/safety/test_limits.py",
            "ssp_core/safety/limits.py",
            "None if abs(measured) <= limit",
            "None if abs(measured) < limit",
        ),
        (
            "session",
            "tests_of_ssp_scenario_manager/test/session/test_limits.py",
            "ssp_scenario_manager/session/limits.py",
            "None if age_s <= limit_s",
            "None if age_s < limit_s",
        ),
        (
            "triggers",
            "tests_of_ssp_scenario_manager/test/triggers/test_conditions.py",
            "ssp_scenario_manager/triggers/conditions.py",
            "> self._age_ns",
            ">= self._age_ns",
        ),
    ],
)
def test_tests_pass_there_and_see_a_change(laid_out, name, tests, file, old, new):
    folder = laid_out[name]
    assert pytest_in(folder, tests).returncode == 0
    source = folder / file
    whole = source.read_text()
    changed = whole.replace(old, new)
    assert changed != whole
    source.write_text(changed)
    try:
        done = pytest_in(folder, "-x", tests)
    finally:
        source.write_text(whole)
    assert done.returncode == 1, done.stdout
    assert "1 failed" in done.stdout


def test_what_mutmut_says_is_read():
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


def test_without_mutmut_it_says_what_to_install(tmp_path, capsys):
    assert run.main([str(tmp_path / "work"), "--mutmut", "no-such-mutmut"]) == 2
    assert "pip install mutmut" in capsys.readouterr().err
    assert not (tmp_path / "work").exists()


def test_a_command_that_is_named_by_a_path_from_here_runs_in_the_folder(
    tmp_path, monkeypatch, capfd
):
    command = tmp_path / "bin" / "mutmut"
    command.parent.mkdir()
    command.write_text("#!/bin/sh\necho at $(basename $PWD): $1\n")
    command.chmod(0o755)
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "pyproject.toml").touch()
    monkeypatch.chdir(tmp_path)
    assert run.main(["work", "--mutmut", "bin/mutmut"]) == 0
    said = capfd.readouterr().out
    assert "at work: run" in said
    assert "0 mutants" in said


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert run.main([str(tmp_path), "--mutmut", sys.executable]) == 2
    assert "name another" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
