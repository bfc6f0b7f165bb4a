"""What a bag carries of its run and task."""

from __future__ import annotations

import pytest

from ssp_core.errors import InputError
from ssp_monitor.recorder import plan
from ssp_monitor.recorder.plan import run_attachments


@pytest.fixture
def run_file(tmp_path):
    path = tmp_path / "run.yaml"
    path.write_text("schema: ssp.run/1\n")
    return path


def test_a_run_without_a_task_is_attached_alone(run_file):
    assert run_attachments(run_file) == [("run.yaml", "application/yaml", b"schema: ssp.run/1\n")]


def test_every_file_of_the_task_is_attached_under_its_name(run_file):
    task = run_file.parent / "task"
    (task / "deeper").mkdir(parents=True)
    for name, text in (
        ("task.json", "{}"),
        ("log.jsonl", ""),
        ("town.xodr", "<OpenDRIVE/>"),
        ("map.bin", "x"),
        ("deeper/no.json", "no"),
    ):
        (task / name).write_text(text)
    assert run_attachments(run_file)[1:] == [
        ("log.jsonl", "application/jsonl", b""),
        ("map.bin", "application/octet-stream", b"x"),
        ("task.json", "application/json", b"{}"),
        ("town.xodr", "application/xml", b"<OpenDRIVE/>"),
    ]


def test_a_run_in_the_task_would_hide_the_executed_one(run_file):
    task = run_file.parent / "task"
    task.mkdir()
    (task / "run.yaml").write_text("another")
    with pytest.raises(InputError, match=r"task/run\.yaml: has the name of the run itself"):
        run_attachments(run_file)


def test_what_is_too_large_is_refused_together(run_file, monkeypatch):
    task = run_file.parent / "task"
    task.mkdir()
    (task / "a.xodr").write_bytes(b"a" * 40)
    (task / "b.xodr").write_bytes(b"b" * 40)
    size = len(run_file.read_bytes()) + 80
    monkeypatch.setattr(plan, "MOST_BYTES", size)
    assert len(run_attachments(run_file)) == 3
    monkeypatch.setattr(plan, "MOST_BYTES", size - 1)
    with pytest.raises(InputError, match=r"b\.xodr: is too large"):
        run_attachments(run_file)


def test_a_missing_run_is_said(tmp_path):
    with pytest.raises(InputError, match=r"run\.yaml: can't be read"):
        run_attachments(tmp_path / "run.yaml")
