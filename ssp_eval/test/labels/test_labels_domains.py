"""Labels of a scenario's recordings together: one plan for all, and what it is worth (METHOD 5.2b).

The three recordings show the same cut-in after run-ups of other lengths, at other paces, as the
domains of a scenario do.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from evaluation_files import CROP, audit_file

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.vocabulary import DOMAINS, ControlState
from ssp_eval.data.labels import compare_labels, counts_text, load_labels, phase_counts
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.run import result_to_json
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.labels.propose import propose
from ssp_eval.labels.review import is_unreviewed, write_proposal
from ssp_eval.labels.truth import truth_from_bag
from ssp_eval.report.page import write_report
from ssp_eval.score.aggregate import means
from ssp_eval.statistics.rows import rows_from_cells
from ssp_eval.statistics.tables.notices import notices
from ssp_eval.statistics.tables.scores import matrix_table
from ssp_scenario_manager.event_spec.load import load_event

Writer = Callable[..., Path]
# Run-up beyond 3 s, seconds for the change of lanes, of the VUT's braking, and how hard it brakes.
PACES = {"synthetic": (0.0, 1.6, 4.5, 1.6), "simulation": (2.5, 2.5, 2.0, 4.0),
         "physical": (3.1, 3.2, 1.1, 7.0)}  # fmt: skip
# C of METHOD 5.2b is longest in Synthetic, 2.9 s: five labels; m + n = 6 leaves two and one.
PLAN = "2/1/5/1"


@pytest.fixture(scope="module")
def record(bag_writer: Writer) -> Callable[..., Path]:
    def write(folder: Path, domain: str, **options: object) -> Path:
        pace = PACES[domain]
        more = {"domain": domain, "duration_s": 12.0 + pace[0], "pace": pace, **options}
        return bag_writer(folder / domain / "bag", **more)

    return write


@pytest.fixture(scope="module")
def recordings(
    tmp_path_factory: pytest.TempPathFactory, record: Callable[..., Path]
) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("recordings")
    return {domain: record(root, domain) for domain in DOMAINS}


def together(recordings: dict[str, Path], out: Path) -> dict[str, Path]:
    """Labels of all three by one plan."""
    sources = [str(bag.parent) for bag in recordings.values()]
    assert main(["labels", "new", *sources, "--out", str(out)]) == 0
    return {domain: out / f"{domain}.labels.json" for domain in recordings}


def by_clock(recordings: dict[str, Path], out: Path) -> dict[str, Path]:
    """Labels of each on a grid of its own, as they were before there were plans."""
    files = {domain: out / f"{domain}.labels.json" for domain in recordings}
    for domain, bag in recordings.items():
        write_proposal(files[domain], propose(truth_from_bag(bag)), "test")
    return files


def test_every_recording_has_as_many_labels_in_each_phase(
    recordings: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = together(recordings, tmp_path)
    assert f"plan: {PLAN} labels in approach/trigger/conflict/resolution of each of 3" in " ".join(
        capsys.readouterr().err.split()
    )
    labels = {domain: load_labels(file) for domain, file in files.items()}
    assert len({tuple(label.at for label in one.labels) for one in labels.values()}) == 1
    assert {one.plan for one in labels.values()} == {"phase"}
    compared = compare_labels(labels)
    assert (compared.comparable, compared.aligned) == (True, True)
    for domain, one in labels.items():
        assert one.domain == domain
        assert all(count >= 1 for count in phase_counts(one).values())
        assert all(b.t_s - a.t_s >= 0.2 - 1e-8 for a, b in pairwise(one.labels))
        assert all(label.at is not None and label.phase == label.at.phase for label in one.labels)
        assert is_unreviewed(files[domain])
        assert main(["labels", "check", str(files[domain])]) == 0
        told = capsys.readouterr().out
        assert f"({counts_text(phase_counts(one))} in approach/trigger/conflict/resolution" in told


def test_a_grid_on_the_clock_gives_the_phases_other_numbers_in_each_domain(
    recordings: dict[str, Path],
) -> None:
    labels = {d: propose(truth_from_bag(bag)).labels for d, bag in recordings.items()}
    assert len({counts_text(phase_counts(one)) for one in labels.values()}) == 3
    compared = compare_labels(labels)
    assert not compared.comparable
    assert compared.line.endswith(": not comparable")


def evaluated(
    recordings: dict[str, Path], labels: dict[str, Path], out: Path, *models: str
) -> dict[str, dict[str, float]]:
    """IVCS by model and domain; every recording is admitted."""
    whole = {"crop": {**CROP, "end_s": 100.0}}
    audit = audit_file(out.parent / "audit.json", "admitted", *recordings.values(), **whole)
    admissions = load_admissions([audit])
    results = run_campaign(
        [(recordings[d], labels[d]) for d in recordings],
        [bridge_spec(name) for name in models],
        InProcessClients(),
        out,
        CellOptions(),
        admissions=admissions,
    )
    found: dict[str, dict[str, float]] = {}
    for result in results:
        assert result.score is not None
        assert sum(result_to_json(result)["labels_per_phase"].values()) == result.score["n"]
        found.setdefault(result.model, {})[result.domain] = result.score["ivcs"]
    return found


def spread(by_domain: dict[str, float]) -> float:
    return max(by_domain.values()) - min(by_domain.values())


@pytest.fixture(scope="module")
def campaigns(
    recordings: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[Path, dict[str, float]]]:
    """Cells of a model that sees nothing, and its IVCS by domain, by labels of both kinds."""
    root, found = tmp_path_factory.mktemp("campaigns"), {}
    for name, make in (("planned", together), ("grid", by_clock)):
        (root / name).mkdir()
        out, labels = root / name / "out", make(recordings, root / name)
        found[name] = (
            out,
            evaluated(recordings, labels, out, "constant_velocity")["constant_velocity"],
        )
    return found


def test_a_blind_model_scores_nearly_the_same_in_all_domains(
    campaigns: dict[str, tuple[Path, dict[str, float]]],
) -> None:
    assert spread(campaigns["planned"][1]) < 0.01
    assert spread(campaigns["grid"][1]) > 0.03


def test_domains_that_do_not_compare_by_their_labels_stay_out_of_domain_means(
    campaigns: dict[str, tuple[Path, dict[str, float]]],
) -> None:
    found = {}
    for name, (out, _) in campaigns.items():
        cells = load_cells(out)
        rows = rows_from_cells(cells)
        told = {
            one.kind: one
            for one in notices(rows, cells)
            if "Labels of" in one.text or "the labels of" in one.text
        }
        page = write_report(out).read_text()
        assert ("labels not comparable between domains" in page) == (name == "grid")
        assert "in approach/trigger/conflict/resolution by " in page
        table = matrix_table(rows)
        keys = [column.key for column in table.columns]
        remarks = {row[keys.index("remark")] for row in table.rows}
        found[name] = [row.admitted for row in rows], told, remarks
        assert bool(means([row.cell() for row in rows], ["domain"])) == all(found[name][0])
        # Means over scenarios and models don't compare domains.
        assert means([row.cell() for row in rows], ["model"])
    admitted, told, remarks = found["planned"]
    assert admitted == [True] * 3
    assert PLAN in told["labels"].text
    assert remarks == {""}
    admitted, told, remarks = found["grid"]
    assert admitted == [False] * 3
    assert told["comparability"].everywhere
    told_text = told["comparability"].text
    assert "Not comparable: the labels of cut_in lie at different places" in told_text
    assert all(str(remark).startswith("not comparable: labels") for remark in remarks)


def test_labels_are_proposed_for_a_live_session(
    tmp_path: Path, record: Callable[..., Path], recordings: dict[str, Path]
) -> None:
    """No simulated world, and participants that say OFF all the time: the states count."""
    live = record(tmp_path, "physical", reported=ControlState.OFF)
    assert main(["labels", "new", str(live)]) == 0
    found = load_labels(live.parent / "bag.labels.json")
    simulated = tmp_path / "simulated.json"
    assert main(["labels", "new", str(recordings["physical"]), "--out", str(simulated)]) == 0
    same = load_labels(simulated)
    assert found.plan == same.plan == "phase"
    assert [x.phase for x in found.labels] == [x.phase for x in same.labels]
    for one, other in zip(found.labels, same.labels, strict=True):
        assert one.t_s == pytest.approx(other.t_s, abs=0.021)
        assert (one.objects, one.position) == (other.objects, other.position)


def test_evaluation_proposes_labels_by_one_plan(
    tmp_path: Path, record: Callable[..., Path]
) -> None:
    bags = [record(tmp_path, domain) for domain in DOMAINS]
    run_campaign(
        [(bag, None) for bag in bags],
        [bridge_spec("silent")],
        InProcessClients(),
        tmp_path / "out",
        CellOptions(),
        propose_labels=True,
    )
    labels = {bag.parent.name: load_labels(bag.parent / "bag.labels.json") for bag in bags}
    compared = compare_labels(labels)
    assert compared.aligned
    assert compared.text == ", ".join(f"{domain} {PLAN}" for domain in DOMAINS)


def files_in(folder: Path) -> set[Path]:
    return {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}


def test_where_no_plan_fits_all_nothing_is_written(
    tmp_path: Path, record: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [record(tmp_path, domain) for domain in DOMAINS[:2]]
    # It ends in the conflict, after 0.9 s of it.
    bags.append(record(tmp_path, "physical", duration_s=7.8))
    before = files_in(tmp_path)
    assert main(["labels", "new", *map(str, bags)]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "no label plan (METHOD 5.2b)" in told
    assert "the conflict needs 5 labels where it is longest" in told
    assert files_in(tmp_path) == before


@pytest.mark.parametrize(
    ("domains", "options", "code", "what"),
    [
        (("simulation", "simulation"), [], 1, "is of the domain simulation, as"),
        (("simulation", "other"), [], 1, "is of the scenario merge,"),
        (("simulation", "physical", "synthetic", "other"), [], 2, "at most 3 recordings"),
        (("simulation", "physical"), ["--truth", "FILE"], 1, "all recordings hold states"),
    ],
)
def test_what_cannot_be_planned_together_is_said(
    domains: tuple[str, ...],
    options: list[str],
    code: int,
    what: str,
    tmp_path: Path,
    recordings: dict[str, Path],
    record: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    other = None
    if "other" in domains:
        other = record(tmp_path, "physical", scenario="merge")
    sources = [str(recordings.get(domain, other)) for domain in domains]
    before = files_in(tmp_path)
    given = [str(tmp_path / "truth.json") if word == "FILE" else word for word in options]
    assert main(["labels", "new", *sources, "--out", str(tmp_path / "out"), *given]) == code
    assert what in " ".join(capsys.readouterr().err.split())
    assert files_in(tmp_path) == before


def test_labels_that_are_there_are_kept_unless_forced(
    tmp_path: Path, record: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [record(tmp_path, domain).parent for domain in DOMAINS]
    mine = runs[1] / "labels.json"
    mine.write_text("mine")
    assert main(["labels", "new", *map(str, runs)]) == 1
    assert "give --force to overwrite what may be reviewed" in capsys.readouterr().err
    assert mine.read_text() == "mine"
    assert not (runs[0] / "labels.json").exists()
    assert main(["labels", "new", *map(str, runs), "--force"]) == 0
    assert all(json.loads((run / "labels.json").read_text())["plan"] == "phase" for run in runs)
    assert all((run / "labels.proposal.json").is_file() for run in runs)
    crop = json.loads((runs[0] / "labels.proposal.json").read_text())["crop"]
    assert crop["chosen_by"].startswith("the whole recording")


def test_templates_of_several_recordings_have_the_plans_times(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    sources = [str(bag) for bag in recordings.values()]
    assert main(["labels", "new", *sources, "--out", str(tmp_path), "--template"]) == 0
    files = together(recordings, tmp_path / "proposed")
    for domain, file in files.items():
        template = json.loads((tmp_path / f"{domain}.labels.json").read_text())
        proposed = load_labels(file)
        assert [x["t_s"] for x in template["labels"]] == [x.t_s for x in proposed.labels]
        assert template["risk_time_s"] == proposed.risk_time_s
        with pytest.raises(InputError, match="template: fill in"):
            load_labels(tmp_path / f"{domain}.labels.json")


@pytest.fixture
def of_k_star(tmp_path: Path, record: Callable[..., Path], task_writer: Writer) -> list[Path]:
    """Simulation and Physical, compiled from the shipped cut_in."""
    bags = []
    for domain in DOMAINS[1:]:
        task = task_writer(tmp_path / domain / "task", domain, lanes=2)
        # Nearer than above: the conflict begins half a second after the trigger.
        pace = (*PACES[domain], 34.0)
        bags.append(record(tmp_path, domain, task=task, pace=pace))
    return bags


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Nine seconds at 24 Hz."""
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 24.0, (96, 54))
    for k in range(216):
        writer.write(np.full((54, 96, 3), k, np.uint8))
    writer.release()
    return path


@pytest.fixture
def imported(video: Path) -> Path:
    """The video as a bag that is declared to show the shipped cut_in."""
    out, version = video.parent / "synthetic" / "bag", load_event("cut_in")[1]
    assert (
        main(
            [
                "import-video",
                str(video),
                "--ego-unknown",
                "--scenario",
                "cut_in",
                "--event-version",
                version,
                "--domain",
                "synthetic",
                "--rate",
                "24",
                "--out",
                str(out),
            ]
        )
        == 0
    )
    return out


@pytest.mark.parametrize("kind", ["bag", "video"])
def test_a_video_alone_gets_a_template_by_the_phases_of_its_k_star(
    kind: str,
    of_k_star: list[Path],
    video: Path,
    imported: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    given = [str(imported if kind == "bag" else video), *map(str, of_k_star), "--out", str(out)]
    if kind == "video":
        # Nobody said that it is the clip of this K*.
        assert main(["labels", "new", *given]) == 1
        assert "the times of its phases are unknown" in " ".join(capsys.readouterr().err.split())
        given += ["--event", "cut_in"]
    assert main(["labels", "new", *given]) == 0
    told = " ".join(capsys.readouterr().err.split())
    template = json.loads((out / "synthetic.labels.json").read_text())
    proposed = [load_labels(out / f"{domain}.labels.json") for domain in DOMAINS[1:]]
    for labels in proposed:
        places = [None if x.at is None else x.at.to_json() for x in labels.labels]
        assert [label["at"] for label in template["labels"]] == places
    assert [label["phase"] for label in template["labels"]] == [x.phase for x in proposed[0].labels]
    assert template["event_version"] == load_event("cut_in")[1]
    # K* has trigger, conflict and resolution at 3.208, 3.333 and 5.5 s.
    starts = {"trigger": 3.208, "conflict": 3.333, "resolution": 5.5}
    ends = {"trigger": 3.333, "conflict": 5.5, "resolution": 9.0}
    for label in template["labels"]:
        if label["phase"] in starts:
            assert starts[label["phase"]] <= label["t_s"] < ends[label["phase"]]
    with pytest.raises(InputError, match="template: fill in"):
        load_labels(out / "synthetic.labels.json")
    assert "METHOD 4.1 from K* cut_in" in told
    mark = json.loads((out / "simulation.labels.proposal.json").read_text())
    window_s = proposed[0].labels[0].t_s, proposed[0].labels[-1].t_s
    assert mark["crop"]["start_s"] <= window_s[0] < window_s[1] <= mark["crop"]["end_s"]
    # a = 3.208 s before the trigger, r = 3.5 s from the resolution on.
    event = mark["event"]
    assert mark["crop"]["start_s"] == pytest.approx(event["trigger_s"] - 3.208)
    assert mark["crop"]["end_s"] == pytest.approx(event["resolution_s"] + 3.5)


def test_the_states_of_an_imported_clip_may_lie_in_its_truth_file(
    of_k_star: list[Path], imported: Path, tmp_path: Path, poses_of_k_star: Callable[..., Any]
) -> None:
    truth = tmp_path / "clip.truth.json"
    frames = []
    for k in range(216):
        t_s = k / 24.0
        objects = []
        for name, (x, y, yaw, speed, _) in zip(
            ("vut", "ot1"), poses_of_k_star(t_s, ahead_m=34.0), strict=True
        ):
            objects.append(
                {
                    "object_id": name,
                    "object_class": "car",
                    "role": "vut" if name == "vut" else "ot",
                    "x_m": x,
                    "y_m": y,
                    "yaw_rad": yaw,
                    "speed_mps": speed,
                    "size": {"front_m": 3.6, "rear_m": 0.9, "width_m": 1.8, "height_m": 1.5},
                }
            )
        frames.append({"t_s": t_s, "objects": objects})
    truth.write_text(json.dumps({"schema": "ssp.truth/1", "scenario": "cut_in", "frames": frames}))
    runs = [str(bag.parent) for bag in (imported, *of_k_star)]
    assert main(["labels", "new", *runs, "--truth", str(truth)]) == 0
    labels = {Path(run).name: load_labels(Path(run) / "labels.json") for run in runs}
    assert compare_labels(labels).aligned
    assert {one.event_version for one in labels.values()} == {load_event("cut_in")[1]}


def test_a_review_keeps_the_plan(
    recordings: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "labels.json"
    assert main(["labels", "new", str(recordings["simulation"]), "--out", str(out)]) == 0
    before = load_labels(out)
    edits = ["e", "phase=conflict", "e", "conflict=null", "hidden"]
    lines = ["a", *edits, *["a"] * (len(before.labels) - 1)]
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(line + "\n" for line in lines)))
    assert main(["spec", "review", str(out), "--who", "A. Author"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "not understood: the phase of a label is its plan's" in told
    assert "at phase approach, s 1.0" in told
    after = load_labels(out)
    assert not is_unreviewed(out)
    assert after.labels[0].conflict is None
    assert [x.at for x in after.labels] == [x.at for x in before.labels]
    assert after.plan == "phase"
