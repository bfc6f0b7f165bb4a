"""Which files the phases of ``ssp test`` read."""

from __future__ import annotations

from pathlib import Path

from ssp_eval.checkout import SESSIONS, _checks, files_of_nodes

ROOT = Path(__file__).parents[2]
FILES = {
    "tests/test_core.py": "def test_it():\n    marked = 1\n",
    "tests/system/test_whole.py": "pytestmark = [pytest.mark.ros, pytest.mark.system]\n",
    "tests/system/conftest.py": "pytest.mark.ros\n",
    "ssp_eval/test/deep/test_one.py": "@pytest.mark.system\ndef test_it(): ...\n",
    "ssp_eval/test/test_param.py": 'pytest.param("ray", marks=pytest.mark.system)\n',
    "ssp_eval/test/test_sample.py": "pytest.mark.rosy\n",
}


def test_the_phase_of_nodes_reads_the_files_that_mark_a_test_of_nodes(tmp_path: Path) -> None:
    for name, text in FILES.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    assert files_of_nodes(tmp_path) == [
        "ssp_eval/test/deep/test_one.py",
        "ssp_eval/test/test_param.py",
        "tests/system/test_whole.py",
    ]


def test_no_other_file_marks_one() -> None:
    """Markers are written out where they are used, so that the text tells who has one."""
    shared = [*ROOT.glob("ssp_*/test/**/conftest.py"), *ROOT.glob("tests/**/conftest.py")]
    assert [f for f in shared if "mark.ros" in f.read_text() or "add_marker" in f.read_text()] == []
    of_nodes = dict(_checks(ROOT, (), False, False))["tests of nodes and sessions"]
    files = files_of_nodes(ROOT)
    assert of_nodes[of_nodes.index("-m", 2 + of_nodes.index("-m")) + 1] == SESSIONS
    assert of_nodes[-len(files) :] == files
    assert "tests/system/test_page.py" in files
