"""The tests that a change reaches, and the files that count as changed."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from ssp_core.errors import HostError, InputError
from ssp_eval.checkout import changed_files
from ssp_eval.import_graph import distances, keep_tests, read_graph

FILES = {
    "pyproject.toml": '[tool.pytest.ini_options]\npythonpath = ["tests", "."]\n'
    '[tool.mypy]\nmypy_path = ["ssp_eval", "ssp_msgs"]\n',
    "conftest.py": "",
    "ssp_msgs/ssp_core/__init__.py": "",
    "ssp_msgs/ssp_core/geometry.py": "",
    "ssp_eval/ssp_eval/__init__.py": "",
    "ssp_eval/ssp_eval/labels/__init__.py": "",
    "ssp_eval/ssp_eval/labels/boxes.py": "from ssp_core import geometry\n",
    "ssp_eval/ssp_eval/labels/cli.py": "def labels():\n    from .boxes import draw\n",
    "ssp_eval/ssp_eval/sites/oval.site.yaml": "name: oval\n",
    "ssp_eval/ssp_eval/broken.py": "def (:\n",
    "ssp_eval/ssp_eval/ros/node.py": "",
    "tests/builders.py": "import ssp_eval.labels.boxes\n",
    "tests/test_boxes.py": "from ssp_eval.labels.boxes import draw\n",
    "tests/test_builders.py": "import builders\n",
    "tests/test_command.py": 'def test_it():\n    main(["labels", "new"])\n',
    "tests/test_word.py": 'def test_it():\n    say("labels")\n',
    "tests/test_site.py": 'SITE = "oval"\n',
    "tests/test_node.py": 'start(["python", "-m", "ssp_eval.ros.node"])\n',
}


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    for file, text in FILES.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("changed", "reached"),
    [
        (
            "ssp_msgs/ssp_core/geometry.py",
            {"tests/test_boxes.py": 2, "tests/test_builders.py": 3, "tests/test_command.py": 3},
        ),
        ("ssp_eval/ssp_eval/labels/cli.py", {"tests/test_command.py": 1}),
        ("ssp_eval/ssp_eval/sites/oval.site.yaml", {"tests/test_site.py": 1}),
        ("ssp_eval/ssp_eval/ros/node.py", {"tests/test_node.py": 1}),
        ("tests/test_word.py", {"tests/test_word.py": 0}),
        ("ssp_eval/ssp_eval/broken.py", {}),
    ],
)
def test_a_change_reaches_what_imports_starts_or_names_it(
    checkout: Path, changed: str, reached: dict[str, int]
) -> None:
    found = distances(read_graph(checkout, FILES), [changed])
    assert {file: found[file] for file in keep_tests(found)} == reached
    assert list(found.values()) == sorted(found.values())


def test_a_conftest_reaches_every_test_below_it(checkout: Path) -> None:
    found = distances(read_graph(checkout, FILES), ["conftest.py"])
    assert set(keep_tests(found)) == set(keep_tests(FILES))


def git(folder: Path, *arguments: str) -> None:
    identity = ("-c", "user.name=x", "-c", "user.email=x@example.org")
    subprocess.run(["git", *identity, *arguments], cwd=folder, check=True, capture_output=True)


def test_new_and_edited_files_have_changed_and_else_those_of_the_last_commit(
    checkout: Path,
) -> None:
    git(checkout, "init", "-q")
    for commit in ("first", "second"):
        (checkout / "conftest.py").write_text(f"# {commit}\n")
        git(checkout, "add", "-A")
        git(checkout, "commit", "-qm", commit)
    assert changed_files(checkout, None) == ["conftest.py"]
    (checkout / "tests/test_boxes.py").write_text("")
    (checkout / "tests/test_new\nfile.py").write_text("")
    (checkout / "tests/test_word.py").unlink()
    assert changed_files(checkout, None) == ["tests/test_boxes.py", "tests/test_new\nfile.py"]
    assert "conftest.py" in changed_files(checkout, "HEAD~1")


@pytest.mark.parametrize(
    ("since", "said"), [("nowhere", "nowhere"), ("--output=x", "--since --output=x is no commit")]
)
def test_what_is_no_commit_is_refused(checkout: Path, since: str, said: str) -> None:
    git(checkout, "init", "-q")
    with pytest.raises((HostError, InputError), match=said):
        changed_files(checkout, since)
    assert not (checkout / "x").exists()
