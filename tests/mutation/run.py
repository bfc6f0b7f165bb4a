"""Mutation testing: which small changes of a folder of source no test notices.

``python tests/mutation/run.py FOLDER --of safety`` copies the package and the tests that judge it
into a folder in which a module's path and name agree, as mutmut needs it, runs mutmut there and
prints the figures and the survivors. mutmut isn't among the project's dependencies: give its
command, or have it on the path. docs/mutation-testing.md holds the last figures and explains the
survivors.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Target:
    """A folder of source that is changed, and the tests that must notice.

    Attributes:
        source: the folder, from the root of the repository; its parent is the package.
        tests: patterns of test files and what they need, from the root of the repository.
        left_out: files of the folder that aren't changed.
        too_slow: words of the names of tests that take seconds per mutant.
    """

    source: str
    tests: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    too_slow: tuple[str, ...] = ()

    @property
    def package(self) -> Path:
        """The package's folder, from the root of the repository."""
        return Path(self.source).parent

    @property
    def changed(self) -> Path:
        """The folder of source as it is imported."""
        return Path(self.package.name, Path(self.source).name)

    def test_files(self) -> list[Path]:
        """The files of tests, from the root of the repository."""
        return [path.relative_to(ROOT) for each in self.tests for path in sorted(ROOT.glob(each))]


_MANAGER = "ssp_scenario_manager/ssp_scenario_manager"
_FIXTURES = ("ssp_scenario_manager/test/conftest.py", "tests/support/**/*.py")
_OF_SESSIONS = ("ssp_scenario_manager/test/session/test_*.py", *_FIXTURES)
TARGETS = {
    "score": Target(
        "ssp_eval/ssp_eval/score",
        (
            "ssp_eval/test/score_inputs.py",
            "ssp_eval/test/score/test_score_*.py",
            "tests/golden/**/*.*",
            "tests/bench/naive_scorer.py",
            "tests/support/rows.py",
        ),
        # What people see: the command's texts and the table. Its own tests look at the content.
        left_out=("cli.py",),
        # Drawn at random and slow; the golden cells under several thresholds stand for them here.
        # What a process imports is no matter of a mutant.
        too_slow=("at_once", "terms_are", "read_aloud", "invariance", "imports"),
    ),
    "safety": Target(
        "ssp_msgs/ssp_core/safety",
        (
            "ssp_msgs/test/safety/test_*.py",
            "ssp_msgs/test/motion/test_object_state.py",
            "ssp_msgs/test/motion/test_state_series.py",
            "ssp_ot_controller/test/conftest.py",
            "ssp_ot_controller/test/objects/test_local_safety.py",
            "ssp_ot_controller/test/objects/test_safety_codes.py",
            "ssp_ot_controller/test/control/test_stopping_room.py",
            "ssp_ot_controller/test/objects/test_target_[cls]*.py",
            *_OF_SESSIONS,
        ),
        # Drawn at random, or judged in processes that see no mutant.
        too_slow=("of_200_sound_tracks", "legal_fences_and_boxes", "another_checkout"),
    ),
    "session": Target(
        f"{_MANAGER}/session",
        (
            "ssp_scenario_manager/test/run/test_inputs.py",
            "ssp_scenario_manager/test/run/test_run_script.py",
            *_OF_SESSIONS,
        ),
    ),
    "triggers": Target(
        f"{_MANAGER}/triggers",
        (
            "ssp_scenario_manager/test/compile/test_fireability*.py",
            "ssp_scenario_manager/test/compile/test_on_route.py",
            "ssp_scenario_manager/test/triggers/test_*.py",
            *_FIXTURES,
        ),
    ),
}
CONFIGURATION = """\
[tool.mutmut]
source_paths = ["{changed}/"]
do_not_mutate = {left_out}
pytest_add_cli_args_test_selection = {selection}
pytest_add_cli_args = {arguments}
also_copy = {copied}

[tool.pytest.ini_options]
addopts = "--import-mode=importlib"
pythonpath = {paths}
markers = ["ros", "programs", "system", "carla"]
"""

# A failure is enough: what the smallest example of it would be, nobody reads. How long an example
# takes says more of the machine.
QUICKLY = """\
from hypothesis import Phase, settings

PHASES = Phase.explicit, Phase.generate
settings.register_profile("quickly", deadline=None, phases=PHASES, database=None)
settings.load_profile("quickly")
"""


def laid_out_test(path: Path) -> Path:
    """Give the place of a test file in the folder, as deep as in the repository.

    Args:
        path: the file, from the root of the repository. The folder of a package's tests gets
            another name there than the package, which pytest would otherwise import in its place.
    """
    first, *rest = path.parts
    return path if first == "tests" else Path(f"tests_of_{first}", *rest)


def lay_out(target: Target, folder: Path) -> None:
    """Copies what mutmut needs into an empty folder, and configures it there."""
    bare = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / target.package, folder / target.package.name, ignore=bare)
    for path in target.test_files():
        place = folder / laid_out_test(path)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, place)
    (folder / "conftest.py").write_text(QUICKLY)
    tests = sorted(path.name for path in folder.glob("tests*"))
    arguments = ["--hypothesis-seed=0", "-m", "not ros and not programs"]
    if target.too_slow:
        arguments += ["-k", " and ".join(f"not {word}" for word in target.too_slow)]
    text = CONFIGURATION.format(
        changed=target.changed.as_posix(),
        left_out=json.dumps([(target.changed / name).as_posix() for name in target.left_out]),
        selection=json.dumps(tests),
        arguments=json.dumps(arguments),
        copied=json.dumps([target.package.name, *tests, "conftest.py", "pyproject.toml"]),
        paths=json.dumps([".", *(name if name == "tests" else f"{name}/test" for name in tests)]),
    )
    (folder / "pyproject.toml").write_text(text)


def outcomes(listing: str) -> dict[str, str]:
    """Read the outcome of each mutant from the lines ``name: outcome`` of ``mutmut results``."""
    found = {}
    for line in listing.splitlines():
        name, colon, outcome = line.strip().partition(": ")
        if colon and "__mutmut_" in name:
            found[name] = outcome
    return found


def main(arguments: list[str] | None = None) -> int:
    """Runs it; 0 if mutmut ran through, whatever survived."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where to work; kept, so that a run can go on")
    parser.add_argument("--of", choices=TARGETS, default="score", help="what is changed")
    parser.add_argument("--mutmut", default="mutmut", help="the command (default: on the path)")
    parser.add_argument("--children", type=int, default=1, help="processes at a time")
    options = parser.parse_args(arguments)
    command = shutil.which(options.mutmut)
    if command is None:
        print(f"{options.mutmut}: no such command; pip install mutmut==3.8.1", file=sys.stderr)
        return 2
    # The configuration is written last, so a folder that has it is whole.
    if not (options.folder / "pyproject.toml").is_file():
        if options.folder.exists() and any(options.folder.iterdir()):
            print(f"{options.folder}: is no folder of such a run; name another", file=sys.stderr)
            return 2
        options.folder.mkdir(parents=True, exist_ok=True)
        lay_out(TARGETS[options.of], options.folder)
    # It runs in the folder, where a path from here leads nowhere.
    mutmut = str(Path(command).absolute())
    run = [mutmut, "run", "--max-children", str(options.children)]
    status = subprocess.run(run, cwd=options.folder, check=False).returncode
    listing = subprocess.run(
        [mutmut, "results", "--all", "true"],
        cwd=options.folder,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    found = outcomes(listing)
    print(f"\n{len(found)} mutants")
    for outcome, count in Counter(found.values()).most_common():
        print(f"{count:6d} {outcome}")
    for name, outcome in found.items():
        if outcome != "killed":
            print(f"{outcome}: {name}")
    return status


if __name__ == "__main__":
    sys.exit(main())
