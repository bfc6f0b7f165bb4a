"""``ssp compile``: outputs, determinism, ties, the log, refusals that leave nothing behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.compile.targets import folder as writer
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import read_log
from ssp_scenario_manager.maps.site import LIBRARY
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Where roads cross: test_maps_crossing_car.py.
EVENTS = tuple(sorted(name for name, kind in KINDS.items() if not kind.at_junction))
MOTORWAY = LIBRARY / "maps" / "motorway.xodr"
COMMON = {"task.json", "event.yaml", "run.yaml", "log.jsonl", "task.html"}

Compile = Callable[..., int]
EventOnRoad = Callable[[str, int, int], str]


@pytest.fixture
def compile_to(tmp_path: Path) -> Compile:
    """Compiles into a folder of the test, by name."""

    def run(event: str, target: str, *more: str, out: str = "out") -> int:
        return main(["compile", event, "--target", target, *more, "--out", str(tmp_path / out)])

    return run


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("event", EVENTS)
def test_a_sumo_task_is_played_by_sumo(event: str, compile_to: Compile, tmp_path: Path) -> None:
    assert compile_to(event, "sumo", "--site", "boulevard") == 0
    folder = tmp_path / "out"
    assert names(folder) == COMMON | {
        "site.yaml",
        "road.net.xml",
        "run.rou.xml",
        "run.add.xml",
        "run.sumocfg",
    }
    # One SUMO per process, so it gets one.
    code = (
        "import libsumo, sys\n"
        "libsumo.start(['sumo', '-c', sys.argv[1], '--no-step-log'])\n"
        "for _ in range(100): libsumo.simulationStep()\n"
        "print(sorted(libsumo.vehicle.getIDList()), sorted(libsumo.person.getIDList()))\n"
        "print([round(x, 1) for x in libsumo.vehicle.getPosition('vut')])\n"
        "print(libsumo.polygon.getIDCount() > 2, libsumo.poi.getIDCount() > 3)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder / "run.sumocfg")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    objects, vut, shapes = done.stdout.splitlines()[-3:]
    for target in load_task(folder).run.targets:
        assert target.id in objects
    assert "vut" in objects
    # It has driven off from s = 15 m, 3.6 m behind its front bumper.
    x, y = json.loads(vut)
    assert 18.6 <= x < 30.0
    assert y == pytest.approx(0.0, abs=0.05)
    assert shapes == "True True"


def test_every_output_names_what_it_was_made_from(compile_to: Compile, tmp_path: Path) -> None:
    version = load_event("vru_crossing")[1]
    for target, own in (
        ("sumo", {"road.net.xml", "run.rou.xml", "run.add.xml", "run.sumocfg"}),
        ("openscenario", {"vru_crossing.xosc", "boulevard.xodr"}),
        ("carla", {"carla_config.json"}),
    ):
        assert compile_to("vru_crossing", target, "--site", "boulevard", out=target) == 0
        task = load_task(tmp_path / target)
        assert task.event.version == version
        assert f'"seed": {task.seed}' in (tmp_path / target / "run.yaml").read_text()
        for name in own | {"task.html", "task.json", "run.yaml"}:
            text = (tmp_path / target / name).read_text()
            assert version in text, name
            assert task.compiler in text, name


def test_a_compiled_folder_holds_what_it_was_made_from(compile_to: Compile, tmp_path: Path) -> None:
    assert compile_to("cut_in", "track", "--site", "north_track", "--seed", "9") == 0
    folder = tmp_path / "out"
    assert names(folder) == COMMON | {"site.yaml"}
    task = load_task(folder)
    shipped = LIBRARY / "events" / "cut_in.event.yaml"
    assert (folder / "event.yaml").read_bytes() == shipped.read_bytes()
    assert (folder / "site.yaml").read_bytes() == (
        LIBRARY / "sites" / "north_track.site.yaml"
    ).read_bytes()
    run = load_run(folder / "run.yaml")
    assert run == task.run
    assert (run.task_version, run.event_version, run.seed) == (
        task.version,
        task.event.version,
        9,
    )
    assert (run.domain, run.stand_in) == ("physical", True)
    assert task.chosen_by == "highest score"
    assert task.ot_reachable
    assert task.safe_stop_zones
    page = (folder / "task.html").read_text()
    assert "not validated" in page
    assert "<svg" in page


def test_the_log_tells_source_and_tunings(compile_to: Compile, tmp_path: Path) -> None:
    assert compile_to("cut_in", "sumo", "--site", "boulevard") == 0
    task = load_task(tmp_path / "out")
    log = read_log(tmp_path / "out" / "log.jsonl")
    assert log[0].kind == "source"
    tunings = {record.field: record for record in log if record.kind == "tuning"}
    assert set(tunings) == {tuning.field for tuning in task.tunings}
    below = tunings["constraints.trigger.below"]
    assert (below.old, below.new) == ({"min": 16.0, "max": 20.0, "unit": "m"}, 18.0)
    assert below.details["task_version"] == task.version
    assert {record.when for record in log} == {"1970-01-01T00:00:00Z"}


def test_the_events_own_log_goes_on_in_the_tasks(compile_to: Compile, tmp_path: Path) -> None:
    event = tmp_path / "mine.event.yaml"
    event.write_bytes((LIBRARY / "events" / "cut_in.event.yaml").read_bytes())
    record = {
        "schema": "ssp.log/1",
        "kind": "accept",
        "when": "2026-03-01T10:00:00Z",
        "who": "Kim",
        "subject": "cut_in",
        "field": "interaction.type",
        "reason": "seen in the clip",
    }
    (tmp_path / "mine.log.jsonl").write_text(json.dumps(record) + "\n")
    assert compile_to(str(event), "sumo", "--site", "boulevard") == 0
    log = read_log(tmp_path / "out" / "log.jsonl")
    assert (log[0].kind, log[0].who) == ("accept", "Kim")
    assert [r.kind for r in log].count("source") == 1


def test_a_refused_clip_is_not_compiled(
    compile_to: Compile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    event = tmp_path / "mine.event.yaml"
    event.write_bytes((LIBRARY / "events" / "cut_in.event.yaml").read_bytes())
    record = {
        "schema": "ssp.log/1",
        "kind": "gate",
        "when": "2026-03-01T10:00:00Z",
        "who": "Kim",
        "subject": "cut_in",
        "reason": "identity drift",
    }
    (tmp_path / "mine.log.jsonl").write_text(json.dumps(record) + "\n")
    assert compile_to(str(event), "sumo", "--site", "boulevard") == 1
    assert "was refused by Kim" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("target", ["sumo", "openscenario", "carla"])
def test_the_same_input_gives_the_same_bytes(
    target: str, compile_to: Compile, event_on_road: EventOnRoad, tmp_path: Path
) -> None:
    event = event_on_road("lead_braking", 3, 0)
    for out in ("one", "two"):
        assert compile_to(event, target, "--map", str(MOTORWAY), out=out) == 0
    for path in sorted((tmp_path / "one").iterdir()):
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes(), path.name
    assert names(tmp_path / "one") == names(tmp_path / "two")


def test_a_seal_shows_every_change(
    compile_to: Compile, event_on_road: EventOnRoad, tmp_path: Path
) -> None:
    event = event_on_road("cut_in", 3, 0)
    assert compile_to(event, "carla", "--map", str(MOTORWAY)) == 0
    file = tmp_path / "out" / "task.json"
    value = json.loads(file.read_text())
    for path in (
        ("limits", "speed_mps"),
        ("trigger", "below"),
        ("run", "driver", "cruise_mps"),
        ("seed",),
    ):
        broken = json.loads(file.read_text())
        node: Any = broken
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] += 1
        file.write_text(json.dumps(broken))
        with pytest.raises(InputError, match="was changed after it was compiled"):
            load_task(file)
        file.write_text(json.dumps(value))
    value["run"]["task_version"] = "sha256:another"
    file.write_text(json.dumps(value))
    with pytest.raises(InputError, match="names another task"):
        load_task(file)


# -- ties -----------------------------------------------------------------------------------------


@pytest.fixture
def two_straights(tmp_path: Path) -> Path:
    """A site with two blocks that are as good as each other."""
    value = yaml.safe_load((LIBRARY / "sites" / "north_track.site.yaml").read_text())
    twin = json.loads(json.dumps(value["blocks"][0]))
    twin["id"] = "other"
    twin["origin"]["y_m"] += 200.0
    value["blocks"].append(twin)
    for name in ("ot_reachable", "safe_stop_zones"):
        value[name] += [{**strip, "block": "other"} for strip in value[name]]
    value["geofence"] = {
        "points": [[400.0, -400.0], [1000.0, -400.0], [1000.0, 400.0], [400.0, 400.0]]
    }
    path = tmp_path / "twins.site.yaml"
    path.write_text(yaml.safe_dump(value))
    return path


def _nobody() -> str:
    raise OSError("No username set in the environment")


def test_a_tie_is_left_to_a_person_and_logged(
    two_straights: Path,
    compile_to: Compile,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    site = ("--site", str(two_straights))
    assert compile_to("cut_in", "track", *site) == 1
    told = capsys.readouterr()
    assert "2 blocks fit equally well: other, straight" in told.err
    assert "--choose" in told.err
    assert told.out.splitlines()[0].split() == ["block", "T", "I", "C", "total"]
    assert not (tmp_path / "out").exists()

    with monkeypatch.context() as nameless:
        nameless.setattr("getpass.getuser", _nobody)
        assert compile_to("cut_in", "track", *site, "--choose", "straight") == 2
        assert "--who" in capsys.readouterr().err
    assert compile_to("cut_in", "track", *site, "--choose", "straight", "--who", " ") == 2
    assert "--who" in capsys.readouterr().err
    assert compile_to("cut_in", "track", *site, "--choose", "straight", "--who", "Kim") == 0
    task = load_task(tmp_path / "out")
    assert (task.block.id, task.chosen_by) == ("straight", "Kim")
    (choice,) = [r for r in read_log(tmp_path / "out" / "log.jsonl") if r.kind == "choice"]
    assert (choice.who, choice.new, choice.details["tied"]) == (
        "Kim",
        "straight",
        ["other", "straight"],
    )
    assert choice.when > "2026"


def test_scores_and_reasons_are_shown(
    compile_to: Compile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compile_to("cut_in", "track", "--site", "south_loop") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[0] == "back"
    assert lines[1].endswith("chosen")
    assert lines[2].startswith("bend")
    assert "rejected: segment curve, needs straight" in lines[2]
    retrieval = load_task(tmp_path / "out").retrieval
    assert [score.block for score in retrieval] == ["back", "bend"]
    assert (retrieval[0].eligible, retrieval[1].eligible) == (True, False)


def test_json_holds_everything(
    compile_to: Compile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compile_to("cut_in", "track", "--site", "south_loop", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    task = load_task(tmp_path / "out")
    assert told["task_version"] == task.version
    assert told["validated_by"] is None
    assert set(told["files"]) == names(tmp_path / "out")
    assert [score["block"] for score in told["scores"]] == ["back", "bend"]


# -- refusals -------------------------------------------------------------------------------------


def event_with(tmp_path: Path, **changes: Any) -> Path:
    value = yaml.safe_load((LIBRARY / "events" / "cut_in.event.yaml").read_text())
    for path, new in changes.items():
        *way, last = path.split("__")
        node = value
        for key in way:
            node = node[key]
        node[last] = new
    file = tmp_path / "changed.event.yaml"
    file.write_text(yaml.safe_dump(value))
    return file


def test_an_event_that_fails_its_checks_is_refused_with_all_failures(
    compile_to: Compile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    event = event_with(
        tmp_path,
        interaction__passing_order=["vut", "ot1"],
        topology__lanes_same_direction={"value": 1, "identity": True},
    )
    assert compile_to(str(event), "sumo", "--site", "boulevard") == 1
    told = capsys.readouterr().err
    assert "interaction.passing_order" in told
    assert "topology.lanes_same_direction" in told
    assert not (tmp_path / "out").exists()
    assert compile_to(str(event), "sumo", "--site", "boulevard", "--json") == 1
    fields = {f["field"] for f in json.loads(capsys.readouterr().out)["failures"]}
    assert fields >= {"interaction.passing_order", "topology.lanes_same_direction"}


REFUSED: dict[str, tuple[tuple[str, ...], int, str]] = {
    "track on a map": (
        ("cut_in", "track", "--map", str(MOTORWAY)),
        2,
        "a track is a site",
    ),
    "track on a simulated site": (
        ("cut_in", "track", "--site", "boulevard"),
        1,
        "is a site of the domain simulation",
    ),
    "no place": (("cut_in", "sumo"), 2, "give --site SITE or --map FILE"),
    "two places": (
        ("cut_in", "sumo", "--site", "boulevard", "--map", str(MOTORWAY)),
        2,
        "give either",
    ),
    "unknown event": (("overtake", "sumo", "--site", "boulevard"), 1, "no such event"),
    "unknown site": (("cut_in", "sumo", "--site", "moon"), 1, "no such site"),
    "missing map": (("cut_in", "sumo", "--map", "none.xodr"), 1, "none.xodr"),
    "a site as a map": (
        ("cut_in", "sumo", "--map", str(LIBRARY / "sites" / "boulevard.site.yaml")),
        1,
        "is a site, no map",
    ),
    "nothing fits": (
        ("vru_crossing", "sumo", "--map", str(MOTORWAY)),
        1,
        "no block of it fits",
    ),
    "unknown block": (
        ("cut_in", "sumo", "--site", "boulevard", "--choose", "x", "--who", "Kim"),
        1,
        "there is no such block",
    ),
    "validation of a simulation": (
        ("cut_in", "sumo", "--site", "boulevard", "--validated-by", "run", "--who", "Kim"),
        2,
        "is for the track",
    ),
    "validation by nothing": (
        ("cut_in", "track", "--site", "north_track", "--validated-by", "run"),
        1,
        "result.json: can't be read",
    ),
    "negative seed": (("cut_in", "sumo", "--site", "boulevard", "--seed", "-1"), 2, "--seed"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_leaves_nothing_behind(
    case: str,
    compile_to: Compile,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, status, text = REFUSED[case]
    assert compile_to(*arguments) == status
    told = capsys.readouterr()
    assert text in told.err
    assert "Traceback" not in told.err
    assert list(tmp_path.iterdir()) == []


def test_a_writer_that_fails_leaves_nothing_behind(
    compile_to: Compile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise InputError("disk full")

    monkeypatch.setattr(writer, "write_target", fail)
    assert compile_to("cut_in", "sumo", "--site", "boulevard") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_replaced_only_on_demand_and_only_our_own(
    compile_to: Compile,
    event_on_road: EventOnRoad,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    event, site = event_on_road("cut_in", 3, 0), ("--map", str(MOTORWAY))
    assert compile_to(event, "carla", *site) == 0
    before = load_task(out).version
    (out / "notes.txt").write_text("mine")
    assert compile_to(event, "carla", *site, "--seed", "2") == 1
    assert "is not empty" in capsys.readouterr().err
    assert load_task(out).version == before
    assert compile_to(event, "carla", *site, "--seed", "2", "--force") == 1
    assert "notes.txt" in capsys.readouterr().err
    (out / "notes.txt").unlink()
    assert compile_to(event, "carla", *site, "--seed", "2", "--force") == 0
    assert load_task(out).version != before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]

    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.txt").write_text("keep")
    assert compile_to(event, "carla", *site, "--force", out="other") == 1
    assert (other / "mine.txt").read_text() == "keep"
    (tmp_path / "file").write_text("x")
    assert compile_to(event, "carla", *site, "--force", out="file") == 1
    assert (tmp_path / "file").read_text() == "x"


def test_a_contradiction_in_a_site_names_its_file(
    compile_to: Compile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "odd.site.yaml"
    text = (LIBRARY / "sites" / "boulevard.site.yaml").read_text()
    path.write_text(text.replace("block: main", "block: other"))
    assert compile_to("cut_in", "sumo", "--site", str(path)) == 1
    said = capsys.readouterr().err.replace("\n", "")
    assert f"{path}: has 5 errors" in said
    assert "ot_reachable[0].block" in said


@pytest.mark.parametrize("out", ["/proc/nowhere", "a" * 300])
def test_a_place_that_takes_no_folder_is_named(
    out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["compile", "cut_in", "--target", "sumo", "--site", "boulevard", "--out", out]) == 1
    said = capsys.readouterr().err
    # An ordinary user may not write to /proc, where root can make no folder.
    assert "can't be made" in said or (os.geteuid() != 0 and "/proc: can't be written to" in said)
    assert list(tmp_path.iterdir()) == []


def test_a_map_whose_name_is_needed_is_refused(
    compile_to: Compile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("road.net.xml", "task.json", "task.html", "log.jsonl"):
        path = tmp_path / name
        path.write_bytes(MOTORWAY.read_bytes())
        assert compile_to("cut_in", "sumo", "--map", str(path)) == 1
        assert name in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
        os.unlink(path)


def test_the_folder_here_is_refused_before_the_compilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ssp_scenario_manager.cli.compile.compile_task", pytest.fail)
    words = ["compile", "cut_in", "--target", "sumo", "--site", "boulevard", "--out"]
    here = "the folder here"
    for out, what in ((".", here), (str(tmp_path), here), ("/sys", "a mount")):
        assert main([*words, out]) == 1
        assert f"{out}: is {what}; name a new folder within it" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
