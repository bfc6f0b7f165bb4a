"""A person's observation goes into the package, bound to the recording by its hash."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from observation_files import answers, seal

from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_eval.package.make import make_package
from ssp_eval.package.model import load_table
from ssp_eval.package.verify import verify_package

Writer = Callable[..., Path]


@pytest.fixture
def run(task_writer: Writer, bag_writer: Writer, tmp_path: Path) -> Path:
    """A compiled run whose recording somebody looked at."""
    run = tmp_path / "run"
    task = task_writer(run / "task", lanes=2)
    bag = bag_writer(run / "bag", task=task, like_k_star=True)
    shutil.copy(task / "run.yaml", run / "run.yaml")
    seal(bag, run / "observation_ada.json", answers())
    return run


def test_an_observation_is_linked_to_what_was_looked_at(run: Path, tmp_path: Path) -> None:
    table, _ = make_package([run], tmp_path / "package")
    roles = {entry.path: entry.role for entry in table.files}
    assert roles["run/observation_ada.json"] == "observation"
    (link,) = [link for link in table.links if link.source == "run/observation_ada.json"]
    assert (link.kind, link.at, link.target) == ("bag", "bag_sha256", "run/bag/bag_0.mcap")
    assert verify_package(tmp_path / "package").ok
    entry = next(e for e in load_table(tmp_path / "package").files if e.path == link.source)
    stored = tmp_path / "package" / "objects" / entry.sha256.removeprefix("sha256:")
    stored.write_text(stored.read_text().replace("Ada Vance", "Ada Vence"))
    (finding,) = verify_package(tmp_path / "package").findings
    assert (finding.kind, finding.file) == ("changed", "run/observation_ada.json")


def test_a_changed_observation_or_one_of_another_recording_is_not_packed(
    run: Path, tmp_path: Path
) -> None:
    path = run / "observation_ada.json"
    whole = json.loads(path.read_text())
    write_json(path, {**whole, "who": "Bo Ek"})
    with pytest.raises(InputError, match="was changed after Bo Ek sealed it"):
        make_package([run], tmp_path / "package")
    path.unlink()
    other = tmp_path / "other"
    shutil.copytree(run / "bag", other / "bag")
    seal(other / "bag", other / "observation.json", answers())
    shutil.rmtree(other / "bag")
    with pytest.raises(InputError, match="names a recording that is not in the package"):
        make_package([run / "task", other], tmp_path / "package")
    assert not (tmp_path / "package").exists()


def test_a_draft_is_kept_and_counts_for_nothing(run: Path, tmp_path: Path) -> None:
    write_json(run / "observation_ada.json", answers())
    table, _ = make_package([run], tmp_path / "package")
    assert not [link for link in table.links if link.source == "run/observation_ada.json"]
