"""Files that our commands wrote and read again, in hostile sizes and shapes: one error each."""

from __future__ import annotations

import os
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from ssp_core.carla.probe_report import load_report as load_carla_report
from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_json
from ssp_core.run_file.faults import load_faults
from ssp_core.run_file.values import Strict
from ssp_core.world.driver_answers import answers_in_event, given_answers
from ssp_eval.evaluate.cli import driving_before
from ssp_eval.evaluate.store.raw_store import check_unchanged
from ssp_eval.evaluate.store.results import load_facts
from ssp_eval.score.score_file import load_score
from ssp_ot_controller.bodies.iso22133.probe_report import load_report as load_iso_report
from ssp_scenario_manager.closed_loop.answers import load_answers
from ssp_scenario_manager.closed_loop.campaigns.forms import (
    SealedStarts,
    check_form,
    read_sealed,
)
from ssp_scenario_manager.closed_loop.campaigns.tries import load_tries
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS
from ssp_scenario_manager.closed_loop.single_run.before import before_of_folder
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.faults.kept import load_cell, load_notes, load_result, load_witness

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "cell": ("cell.json", load_facts),
    "score": ("score.json", load_score),
    "task": ("task.json", load_task),
    "fault file": ("faults.yaml", load_faults),
    "CARLA probe": ("carla_probe.json", load_carla_report),
    "ISO probe": ("probe.json", load_iso_report),
    "starts": ("starts.json", lambda file: check_form(SealedStarts, read_sealed(file), file)),
    "answers": ("answers.json", lambda file: load_answers(file, "ask again")),
    "answers in the event": ("answers.json", answers_in_event),
    "answers of a node": ("answers.jsonl", given_answers),
    "tries": ("000001.failed.json", load_tries),
    "driven result": ("result.json", lambda file: before_of_folder(file.parent)),
    "result of a fault": ("result.json", lambda file: load_result(file.parent)),
    "injected faults": ("faults.json", lambda file: load_notes(file.parent)),
    "witness": ("witness.json", lambda file: load_witness(file.parent)),
}
TEXTS: dict[str, bytes] = {
    "cut off": b'{"schema": "ssp.\n',
    "deep": b"[" * 10_000 + b"]" * 10_000 + b"\n",
    "deep in a field": b'{"event": ' + b"[" * 10_000 + b"]" * 10_000 + b"}\n",
    "unknown keys": b'{"event": 5,' + b",".join(b'"k%06d": 1' % k for k in range(100_000)) + b"}\n",
    "a million rows": b'{"event": [' + b"0," * 1_000_000 + b"0]}\n",
    "a long text": b'{"event": "' + b"x" * 4_000_000 + b'"}\n',
    "a long number": b'{"event": 1' + b"0" * 5000 + b"}\n",
    "a huge number": b'{"event": [1e308, 1e999]}\n',
    "not a number": b'{"event": NaN}\n',
    "a number for all": b'{"event": 5, "free": 5, "asked": 5, "driven": 5, "verdict": 5}\n',
    "a key twice": b'{"event": 1, "event": 1}\n',
    "half a surrogate pair": b'{"\\ud800": "\\udfff"}\n',
    "UTF-16": '{"event": 1}\n'.encode("utf-16"),
    "binary": bytes(range(256)) * 100 + b"\n",
    "a list": b"[{}]\n",
    "a number": b"7\n",
}
PLACES: dict[str, Callable[[Path], None]] = {
    "link to itself": lambda file: file.symlink_to(file.name),
    "pipe": lambda file: os.mkfifo(file),
    "folder": lambda file: file.mkdir(),
    "device": lambda file: file.symlink_to("/dev/zero"),
}


def put(file: Path, kind: str) -> None:
    if kind in PLACES:
        PLACES[kind](file)
    else:
        file.write_bytes(TEXTS[kind])


@pytest.mark.parametrize("kind", [*TEXTS, *PLACES])
def test_each_reader_refuses_a_hostile_file_by_its_name(kind: str, tmp_path: Path) -> None:
    for what, (name, read) in READERS.items():
        file = tmp_path / what.replace(" ", "_") / name
        file.parent.mkdir()
        put(file, kind)
        if kind == "link to itself":  # no file is there, without which some may go
            with suppress(InputError):
                read(file)
            continue
        with pytest.raises(InputError) as caught:
            read(file)
        error = caught.value.parts[0] if caught.value.parts else caught.value
        assert str(file) in str(caught.value), what
        assert error.remedy, (what, str(error))
        assert len(str(caught.value)) < 50_000, what


@pytest.mark.parametrize("kind", [*TEXTS, *PLACES])
def test_a_cell_that_can_not_be_read_is_asked_again(kind: str, tmp_path: Path) -> None:
    """`ssp evaluate` and `ssp faults` write it anew."""
    file = tmp_path / "cells" / "a__simulation__constant_velocity" / "cell.json"
    file.parent.mkdir(parents=True)
    put(file, kind)
    check_unchanged(file.parent)
    driving_before(tmp_path)
    assert load_cell(file.parent) is None


class Options(Strict):
    options: dict[str, Any]


@pytest.mark.parametrize("text", ["{x: .nan}", "{x: [1, {y: -.inf}]}", '{"x": 1e999}'])
def test_a_number_in_a_value_of_any_form_is_finite(text: str, tmp_path: Path) -> None:
    """Such values are hashed, which ended in a traceback."""
    file = tmp_path / "file.yaml"
    file.write_text(f"options: {text}\n")
    with pytest.raises(InputError, match="finite") as caught:
        load_model(Options, file)
    assert (caught.value.field, caught.value.file) == ("options.x", str(file))
    write_json(file, {"options": {"x": [1, 2.5, None, "a"]}})
    assert load_model(Options, file).options["x"][1] == 2.5


def test_a_number_of_400_digits_in_a_driven_result_is_no_number(tmp_path: Path) -> None:
    driven = {**dict.fromkeys(RUN_COLUMNS, 10**400), "chain": {}}
    file = tmp_path / "result.json"
    write_json(file, {"verdict": "valid", "in_process": True, "driven": driven})
    with pytest.raises(InputError, match="doesn't say what the run was") as caught:
        before_of_folder(tmp_path)
    assert caught.value.file == str(file)
    assert caught.value.remedy


def test_a_file_beyond_its_limit_is_refused_unread(tmp_path: Path) -> None:
    """A gibibyte of 20 was read, which took two of memory."""
    file = tmp_path / "plan.json"
    with file.open("wb") as stream:
        stream.truncate(20 << 30)
    tracemalloc.start()
    with pytest.raises(InputError, match="is larger than 1024 MiB"):
        read_sealed(file)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 16 << 20
