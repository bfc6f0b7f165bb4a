"""Mutation testing of the scoring core: which small changes of ssp_eval.score no test notices.

``python tests/mutation/run.py`` copies the package, its scoring tests and the golden cases into a
folder in which a module's path and name agree, as mutmut needs it, runs mutmut there and prints
the figures and the survivors. mutmut isn't among the project's dependencies: give its command, or
have it on the path. docs/mutation-testing.md holds the last figures and explains the survivors.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = (
    "aggregate",
    "batch",
    "cli",
    "columns",
    "invariance",
    "load",
    "matching",
    "motion",
    "properties",
    "risk",
    "semantics",
    "thresholds",
)
# What people see: the command's texts and the table. Its own tests look at the content.
LEFT_OUT = ("ssp_eval/score/cli.py",)
# Drawn at random and slow; the golden cells under several thresholds stand for them here.
TOO_SLOW = ("not at_once", "not terms_are", "not read_aloud", "not invariance")
CONFIGURATION = """\
[tool.mutmut]
source_paths = ["ssp_eval/score/"]
do_not_mutate = {left_out}
pytest_add_cli_args_test_selection = ["checks", "tests/golden"]
pytest_add_cli_args = {arguments}
also_copy = ["ssp_eval", "checks", "tests", "pyproject.toml"]

[tool.pytest.ini_options]
addopts = "--import-mode=importlib"
pythonpath = ["checks/test"]
"""

# A failure is enough: what the smallest example of it would be, nobody reads.
QUICKLY = """\
from hypothesis import Phase, settings

settings.register_profile("quickly", phases=(Phase.explicit, Phase.generate), database=None)
settings.load_profile("quickly")
"""


def lay_out(folder: Path) -> None:
    """Copies what mutmut needs into an empty folder, and configures it there."""
    bare = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "ssp_eval" / "ssp_eval", folder / "ssp_eval", ignore=bare)
    shutil.copytree(ROOT / "tests" / "golden", folder / "tests" / "golden", ignore=bare)
    (folder / "tests" / "bench").mkdir()
    shutil.copy(ROOT / "tests" / "bench" / "naive_scorer.py", folder / "tests" / "bench")
    # As deep as in the source tree: a test looks for tests/ from there.
    tests = folder / "checks" / "test"
    (tests / "score").mkdir(parents=True)
    for name in ("score_inputs", *(f"score/test_score_{name}" for name in TESTS)):
        shutil.copy(ROOT / "ssp_eval" / "test" / f"{name}.py", tests / f"{name}.py")
    (tests / "conftest.py").write_text(QUICKLY)
    text = CONFIGURATION.format(
        left_out=json.dumps(LEFT_OUT),
        arguments=json.dumps(["--hypothesis-seed=0", "-k", " and ".join(TOO_SLOW)]),
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
    parser.add_argument("--mutmut", default="mutmut", help="the command (default: on the path)")
    parser.add_argument("--children", type=int, default=1, help="processes at a time")
    options = parser.parse_args(arguments)
    if shutil.which(options.mutmut) is None:
        print(f"{options.mutmut}: no such command; pip install mutmut==3.8.1", file=sys.stderr)
        return 2
    # The configuration is written last, so a folder that has it is whole.
    if not (options.folder / "pyproject.toml").is_file():
        if options.folder.exists() and any(options.folder.iterdir()):
            print(f"{options.folder}: is no folder of such a run; name another", file=sys.stderr)
            return 2
        options.folder.mkdir(parents=True, exist_ok=True)
        lay_out(options.folder)
    run = [options.mutmut, "run", "--max-children", str(options.children)]
    status = subprocess.run(run, cwd=options.folder, check=False).returncode
    listing = subprocess.run(
        [options.mutmut, "results", "--all", "true"],
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
