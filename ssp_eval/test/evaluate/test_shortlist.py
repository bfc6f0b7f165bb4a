"""The funnel: candidates for the track from two campaigns, and the compiler that asks for them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file
from ssp_core.run_file.shortlist import Limits, ListedEvent, Shortlist, load_candidate
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import CellData, load_cells
from ssp_eval.score.engine import cell_terms
from ssp_eval.statistics.bootstrap import SEED, bootstrap_records
from ssp_eval.statistics.rows import rows_from_cells
from ssp_eval.statistics.tables.shortlist import DEFAULT_LIMITS, shortlist
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import read_log

MODELS = ("constant_velocity", "opencv_baseline")
FEW = 200


@pytest.fixture(scope="module")
def stages(
    bag_writer: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path]:
    """A synthetic and a simulation campaign of two events and two models."""
    folder = tmp_path_factory.mktemp("stages")
    models = [bridge_spec(name) for name in MODELS]
    found = []
    for domain in ("synthetic", "simulation"):
        bags = [
            (bag_writer(folder / domain / name, domain=domain, scenario=name), None)
            for name in ("cut_in", "vru_crossing")
        ]
        out = folder / f"{domain}_campaign"
        run_campaign(bags, models, InProcessClients(), out, CellOptions(), True)
        found.append(out)
    return found[0], found[1]


def listed(stages: tuple[Path, Path], **limits: Any) -> Shortlist:
    chosen = DEFAULT_LIMITS.model_copy(update=limits)
    return shortlist(load_cells(stages[0]), load_cells(stages[1]), chosen, FEW)


def test_shares_and_priority_are_those_of_the_cells(stages: tuple[Path, Path]) -> None:
    found = listed(stages)
    cells = [*load_cells(stages[0]), *load_cells(stages[1])]
    assert found.models == sorted(MODELS)
    assert {one.scenario for one in found.events} == {"cut_in", "vru_crossing"}
    for one in found.events:
        own = [cell for cell in cells if cell.scenario == one.scenario]
        scores = [cell.score for cell in own if cell.score is not None]
        assert len(scores) == 4
        assert one.no_response == sum(not score.rsr for score in scores) / 4
        terms = [cell_terms(cell.labels, cell.records, cell.thresholds) for cell in own]
        with_terms = list(zip(rows_from_cells(own), terms, strict=True))
        ends = [
            e["ivcs"].percentile
            for e in bootstrap_records(with_terms, (), FEW, SEED).cells.values()
        ]
        widths = [(end.high or 0.0) - (end.low or 0.0) for end in ends]
        assert one.width == pytest.approx(sum(widths) / 4)
        assert one.turned == 0.0  # both stages show the same motion
        assert one.priority == pytest.approx((one.no_response + one.width) / 3)
        assert one.cells == sorted(sha256_file(cell.folder / "cell.json") for cell in own)
        for stage, counts in one.first_failures.items():
            assert sum(counts) == sum(score.details.first_failures[stage] for score in scores)
    assert found.notes
    assert "No audit admitted these recordings" in found.notes[0]


def test_limits_choose_the_candidates(stages: tuple[Path, Path]) -> None:
    none = listed(stages, no_response=1.0, turned=1.0, width=1.0)
    silent = {one.scenario for one in none.events if one.no_response == 1.0}
    assert {one.scenario for one in none.events if one.rank} == silent
    every = listed(stages, width=0.0)
    assert [one.rank for one in every.events] in ([1, 2], [1, 1])
    assert all("intervals of IVCS over labels are" in one.reasons[-1] for one in every.events)
    first = listed(stages, width=0.0, most=1)
    assert {one.scenario for one in first.events if one.rank == 1} == {
        one.scenario for one in every.events if one.rank == 1
    }


def test_ranks_that_turn_between_the_stages_are_named(
    stages: tuple[Path, Path], tmp_path: Path
) -> None:
    """The answers of the two models change places in the simulation of one event."""
    first, second = load_cells(stages[0]), load_cells(stages[1])
    swapped = []
    for cell in second:
        if cell.scenario == "cut_in":
            (other,) = [
                one for one in second if one.scenario == "cut_in" and one.model != cell.model
            ]
            facts = cell.facts.model_copy(update={"model": other.model})
            cell = type(cell)(**{**vars(cell), "facts": facts})
        swapped.append(cell)
    found = shortlist(first, swapped, DEFAULT_LIMITS, FEW)
    by = {one.scenario: one for one in found.events}
    assert (by["cut_in"].turned, by["vru_crossing"].turned) == (1.0, 0.0)
    ranks = by["cut_in"].ranks
    assert {tuple(pair) for pair in ranks.values()} == {(1, 2), (2, 1)}
    assert any("ranks turn from synthetic to simulation" in text for text in by["cut_in"].reasons)
    assert found.events[0].scenario == "cut_in"


def test_what_can_t_be_compared_is_left_out_and_said(stages: tuple[Path, Path]) -> None:
    first, second = load_cells(stages[0]), load_cells(stages[1])
    facts = {
        cell.id: cell.facts.model_copy(update={"event_version": "sha256:other"}) for cell in second
    }
    others = [
        type(cell)(**{**vars(cell), "facts": facts[cell.id]})
        for cell in second
        if cell.scenario == "cut_in"
    ]
    found = shortlist(first, others, DEFAULT_LIMITS, FEW)
    told = {one.scenario: one.why for one in found.left_out}
    assert told["cut_in"].startswith("its recordings are of 2 versions of K*")
    assert told["vru_crossing"] == "it has no scored cell in simulation"
    assert found.events == []
    with pytest.raises(InputError, match="holds no scored cell of a model in the domain synthetic"):
        shortlist(second, first, DEFAULT_LIMITS, FEW)


def after_an_outage(cell: CellData, **facts: Any) -> CellData:
    answers = cell.facts.answers.model_copy(
        update={"missing_by_kind": {"bridge overloaded": 5, "the model declined": 1}}
    )
    changed = cell.facts.model_copy(update={"answers": answers, **facts})
    return type(cell)(**{**vars(cell), "facts": changed})


def test_an_event_that_lost_answers_to_an_outage_is_left_out(stages: tuple[Path, Path]) -> None:
    first, second = load_cells(stages[0]), load_cells(stages[1])
    at = next(i for i, cell in enumerate(second) if cell.scenario == "cut_in")
    lost = after_an_outage(second[at])
    found = shortlist(first, [*second[:at], lost, *second[at + 1 :]], DEFAULT_LIMITS, FEW)
    assert [one.scenario for one in found.events] == ["vru_crossing"]
    (left,) = found.left_out
    assert left.scenario == "cut_in"
    assert f"{lost.model} (simulation): 5 answers missing: bridge overloaded" in left.why
    assert "declined" not in left.why
    assert "ask again with --retry-errors" in left.why


def test_an_outage_outside_of_the_two_stages_costs_no_event(stages: tuple[Path, Path]) -> None:
    first, second = load_cells(stages[0]), load_cells(stages[1])
    outside = [
        after_an_outage(second[0], domain="physical"),
        after_an_outage(first[0]),  # the synthetic stage is that of the first campaign
    ]
    found = shortlist(first, [*second, *outside], DEFAULT_LIMITS, FEW)
    assert {one.scenario for one in found.events} == {"cut_in", "vru_crossing"}
    assert found.left_out == []


def test_the_verb_lists_explains_and_writes(
    stages: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    syn, sim = map(str, stages)
    file = tmp_path / "shortlist.json"
    more = ["--width", "0", "--resamples", "200"]
    assert main(["shortlist", syn, sim, *more, "--out", str(file)]) == 0
    told = capsys.readouterr()
    assert "priority" in told.out
    assert "cut_in" in told.out
    assert "share of pairs of models whose order by IVCS turns" in " ".join(told.err.split())
    assert main(["shortlist", syn, sim, *more, "--json"]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed)["schema"] == "ssp.shortlist/1"
    assert printed == file.read_text("utf-8")
    assert main(["shortlist", syn, sim, "--no-response", "2"]) == 2
    assert main(["shortlist", syn, str(tmp_path / "none")]) == 1
    assert "none: is not there; give the --out folder of `ssp evaluate`" in capsys.readouterr().err
    (tmp_path / "none").mkdir()
    assert main(["shortlist", syn, str(tmp_path / "none")]) == 1
    assert "none: holds no evaluated cells" in capsys.readouterr().err


def candidate(version: str, rank: int | None = 1, scenario: str = "cut_in") -> ListedEvent:
    return ListedEvent(
        scenario=scenario,
        event_version=version,
        rank=rank,
        priority=0.5,
        no_response=1.0,
        turned=0.0,
        width=0.5,
        ranks={"m": (1, 1)},
        first_failures={"risk_response": (1, 2)},
        reasons=["no risk response: m (synthetic)"],
        cells=[],
    )


def write_list(path: Path, *events: ListedEvent) -> Path:
    limits = Limits(no_response=0.5, turned=0.25, width=0.3, most=10)
    found = Shortlist(
        software="ssp", limits=limits, models=["m"], events=list(events), left_out=[], notes=[]
    )
    write_json(path, json.loads(found.model_dump_json(by_alias=True)))
    return path


def test_the_compiler_takes_a_candidate_and_keeps_the_list(tmp_path: Path) -> None:
    _, version = load_event("cut_in")
    file = write_list(tmp_path / "list.json", candidate(version, rank=3))
    track = ["compile", "cut_in", "--target", "track", "--site", "north_track"]
    assert main([*track, "--shortlist", str(file), "--out", str(tmp_path / "task")]) == 0
    assert (tmp_path / "task/shortlist.json").read_bytes() == file.read_bytes()
    (record,) = [one for one in read_log(tmp_path / "task/log.jsonl") if one.kind == "shortlist"]
    assert record.version == version
    assert record.details["sha256"] == sha256_file(file)
    assert record.details["rank"] == 3
    assert record.reason == "no risk response: m (synthetic)"
    # A compiled folder with its list is one that may be compiled anew.
    assert main([*track, "--out", str(tmp_path / "task"), "--force"]) == 0
    assert not (tmp_path / "task/shortlist.json").exists()


@pytest.mark.parametrize(
    ("events", "told"),
    [
        ([], "is not on the shortlist"),
        ([("this", None)], "is on the shortlist and no candidate"),
        ([("sha256:" + "1" * 64, 1)], "is on the shortlist in another version, sha256:1111"),
    ],
)
def test_the_compiler_refuses_what_is_no_candidate_and_writes_nothing(
    events: list[tuple[str, int | None]],
    told: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, version = load_event("cut_in")
    entries = [candidate(version if name == "this" else name, rank) for name, rank in events]
    other = candidate("sha256:" + "2" * 64, 1, "vru_crossing")
    file = write_list(tmp_path / "list.json", *entries, other)
    track = ["compile", "cut_in", "--target", "track", "--site", "north_track"]
    assert main([*track, "--shortlist", str(file), "--out", str(tmp_path / "task")]) == 1
    err = " ".join(capsys.readouterr().err.split())
    assert f"list.json: events: {told}" in err
    assert "vru_crossing" in err
    assert not (tmp_path / "task").exists()
    sumo = ["compile", "cut_in", "--target", "sumo", "--site", "boulevard"]
    assert main([*sumo, "--shortlist", str(file), "--out", str(tmp_path / "task")]) == 2


def test_a_file_that_is_no_list_is_named(tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text('{"schema": "ssp.shortlist/2"}')
    with pytest.raises(InputError, match=r"list\.json"):
        load_candidate(tmp_path / "list.json", "cut_in", "sha256:" + "0" * 64)
