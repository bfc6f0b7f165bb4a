"""``ssp bench`` says beside each figure whether its limit is kept, and ends accordingly."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from ssp_eval import bench

ROOT = Path(__file__).resolve().parents[2]
FIGURE = {
    "name": "dispatch: p99 beside a bare node",
    "ours": 2.0,
    "bound": 1.0,
    "unit": "ms",
    "ratio": 2.0,
    "limit": None,
    "kept": True,
    "note": "22 objects at 100 Hz, 600 triggers",
}
MISSED = {"limit": "ratio <= 1.5", "kept": False}
KEPT = {"limit": "ratio <= 1.5", "kept": True, "ours": 1.2, "ratio": 1.2}


def measured(
    monkeypatch: pytest.MonkeyPatch, runs: list[dict[str, Any]], *options: str
) -> tuple[int, str, int]:
    """Exit status, output and number of runs of a benchmark that gives these figures in turn."""
    monkeypatch.setenv("SSP_ROOT", str(ROOT))
    left = [FIGURE | run for run in runs]
    monkeypatch.setattr(bench, "run_benchmark", lambda folder, name, long: [left.pop(0)])
    done = CliRunner().invoke(bench.bench, ["dispatch", *options], standalone_mode=False)
    return done.return_value, done.stdout, len(runs) - len(left)


@pytest.mark.parametrize(
    ("runs", "status", "words"),
    [
        ([{}], 0, ["2 ms", "x 2.00"]),
        ([KEPT], 0, ["ok", "ratio <= 1.5"]),
        ([MISSED, KEPT, KEPT], 0, ["noisy", "missed in 1 of 3 runs: 2, 1.2, 1.2 ms"]),
        ([MISSED, KEPT, MISSED], 1, ["MISSED", "ratios 2.00, 1.20, 2.00"]),
        ([{"bound": None, "ratio": None, "limit": "<= 5 ms"}], 0, ["ok", "<= 5"]),
    ],
)
def test_a_missed_limit_is_measured_again_and_told_apart_from_noise(
    monkeypatch: pytest.MonkeyPatch, runs: list[dict[str, Any]], status: int, words: list[str]
) -> None:
    ended, shown, used = measured(monkeypatch, runs)
    assert (ended, used) == (status, len(runs))
    for word in words:
        assert word in shown
    assert ("ok" in shown) == ("ok" in words)


def test_without_a_browser_its_row_is_left_out_and_named_at_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SSP_ROOT", str(ROOT))
    measured: list[str] = []
    monkeypatch.setattr(
        bench, "run_benchmark", lambda folder, name, long: measured.append(name) or [FIGURE]
    )
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr(bench, "find_spec", lambda name: name)
    said: list[str] = []
    monkeypatch.setattr(bench.console, "note", lambda line: said.append(f"{line} {measured}"))
    done = CliRunner().invoke(bench.bench, [], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 0)
    assert measured == [name for name in bench.BENCHMARKS if name != "report_page"]
    (line,) = said
    assert line.startswith("there is no browser (chromium")
    assert line.endswith("left out: report_page []")  # before anything was measured
    done = CliRunner().invoke(bench.bench, ["report_page"], standalone_mode=False)
    assert "apt-get install chromium" in str(done.exception)


def test_without_carlas_client_its_row_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SSP_ROOT", str(ROOT))
    measured: list[str] = []
    monkeypatch.setattr(
        bench, "run_benchmark", lambda folder, name, long: measured.append(name) or [FIGURE]
    )
    monkeypatch.setattr("shutil.which", lambda name: name)
    monkeypatch.setattr(bench, "find_spec", lambda name: None)
    done = CliRunner().invoke(bench.bench, [], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 0)
    assert measured == [name for name in bench.BENCHMARKS if name != "carla"]
    done = CliRunner().invoke(bench.bench, ["carla"], standalone_mode=False)
    assert "CARLA's client isn't installed" in str(done.exception)


def test_a_figure_is_a_line_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    _, shown, _ = measured(monkeypatch, [KEPT])
    assert shown.splitlines()[0] == "dispatch"
    (line,) = shown.splitlines()[1:]
    assert len(line) <= 80
    _, shown, _ = measured(monkeypatch, [KEPT], "--notes")
    assert "bound: 1 ms" in shown
    assert "22 objects at 100 Hz, 600 triggers" in shown


def test_programs_get_the_run_in_the_middle_and_how_many_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, shown, _ = measured(monkeypatch, [MISSED, KEPT, KEPT | {"ours": 1.1}], "--json")
    told = json.loads(shown)
    assert (told["ours"], told["kept"], told["runs"], told["missed"]) == (1.2, True, 3, 1)


@pytest.mark.parametrize("name", bench.BENCHMARKS)
def test_each_benchmark_finds_all_that_it_imports(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tests"))
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "bench"))
    assert callable(importlib.import_module(bench.file_of(name).removesuffix(".py")).main)


def test_growth_is_that_between_the_larger_sizes_without_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tests"))
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "bench"))
    exponent = importlib.import_module("growth").exponent
    sizes = (10, 30, 90)
    for power in (1.0, 1.2, 2.0):
        costs = [1.5 + (size / 10.0) ** power for size in sizes]
        assert exponent(sizes, costs, 1.5) == pytest.approx(power)
    assert exponent(sizes, [1.5, 1.5, 1.6], 1.5) == 0.0  # nothing to judge
    assert exponent(sizes, [1.5, 1.4, 9.5], 1.5) > 1.2
