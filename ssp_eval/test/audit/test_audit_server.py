"""Recordings that CARLA drew: what of the server is disclosed, and what keeps them out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.carla.probe_report import CarlaProbeReport, write_report
from ssp_core.carla.record import CarlaPlantRecord, CarlaScene
from ssp_core.errors import InputError
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.road import Building, Sign
from ssp_core.vocabulary import DOMAINS, ObjectClass
from ssp_eval.audit import server
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import judge
from ssp_eval.audit.server import server_disclosures, server_findings
from ssp_eval.data.drawn import Redrawing
from ssp_eval.data.provenance import (
    CARLA,
    COUNTERPART,
    OUR_RENDERER,
    Provenance,
    read_provenance,
)
from ssp_eval.data.server import PROBE_FILE, ServerProbe, read_probe
from ssp_scenario_manager.event_spec.load import load_event
from tests.support.bags.worlds import CAMERA, record_world, small_world

TRUCK_BOX = {
    "length_m": 8.47,
    "width_m": 2.89,
    "height_m": 3.83,
    "forward_m": -0.25,
    "right_m": 0.0,
    "up_m": 1.91,
}
TRUCK = "vehicle.carlamotors.firetruck"
TRIGGER = {
    "id": "near",
    "object_id": "ot1",
    "condition": {"type": "time_to_arrival", "anchor": [121.0, 0.0], "below_s": 3.2},
    "manoeuvre": {"kind": "brake"},
    "adaptation": None,
    "lead_time_s": 0.1,
    "not_before_s": 4.0,
}


def a_scene(**changes: Any) -> CarlaScene:
    body = {
        "blueprint": TRUCK,
        "box": TRUCK_BOX,
        "size": asdict(DEFAULT_SIZES[ObjectClass.TRUCK]),
    }
    told = {
        "version": "0.9.16",
        "client_version": "0.9.16",
        "map_name": "Carla/Maps/Town01",
        "map_sha256": "sha256:a",
        "synchronous": True,
        "step_s": 0.1,
        "first_frame": 1234,
        "seed": 7,
        "rate_hz": 10.0,
        "camera": {"fov": "75"},
        "settings": {},
        "weather": {"cloudiness": 10.0},
        "triggers": [TRIGGER],
        "bodies": {"ot1": body},
    }
    return CarlaScene.model_validate({**told, **changes})


def a_probe(**changes: Any) -> ServerProbe:
    rows = [{"check": c, "outcome": "pass"} for c in ("teleport", "frames", "box_in_picture")]
    told = {
        "host": "gpu7",
        "port": 2000,
        "version": "0.9.16",
        "client_version": "0.9.16",
        "started": "2025-11-20T10:00:00Z",
        "map_name": "Carla/Maps/Town01",
        "map_sha256": "sha256:a",
        "settings": {},
        "camera": {},
        "rows": rows,
        "bodies": [{"blueprint": TRUCK, "base_type": "truck", "wheels": 4, **TRUCK_BOX}],
    }
    report = CarlaProbeReport.model_validate({**told, **changes})
    return ServerProbe(report, "sha256:" + "0" * 64)


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> Provenance:
    """A session whose camera is CARLA's, of which the bag says nothing more."""
    spec = small_world(camera={**CAMERA, "renderer": "carla"})
    run = record_world(tmp_path_factory.mktemp("server") / "run", steps=1, run=spec)
    with BagReader(run / "bag") as bag:
        return read_provenance(bag)


def words(facts: Provenance) -> list[str]:
    return [finding.detail for finding in server_findings(facts)]


def test_a_probed_server_is_taken(facts: Provenance) -> None:
    assert facts.renderer == CARLA
    sound = replace(facts, scene=a_scene(), probe=a_probe())
    assert words(sound) == []
    # A body that was measured to the centimetre has the same box.
    near = {**TRUCK_BOX, "length_m": 8.475}
    body = {"blueprint": TRUCK, "base_type": "truck", "wheels": 4, **near}
    assert words(replace(sound, probe=a_probe(bodies=[body]))) == []


def test_what_no_server_drew_needs_no_probe(facts: Provenance) -> None:
    run = facts.run
    assert run is not None
    assert run.camera is not None
    raster = run.model_copy(update={"camera": run.camera.model_copy(update={"renderer": "raster"})})
    ours = replace(facts, run=raster)
    assert ours.renderer == OUR_RENDERER
    assert words(ours) == []
    assert server_disclosures(ours) == {}


def test_nothing_that_a_server_drew_is_admitted_without_evidence(
    facts: Provenance,
) -> None:
    failed = [
        {"check": "teleport", "outcome": "fail"},
        {"check": "frames", "outcome": "pass"},
        {"check": "box_in_picture", "outcome": "pass"},
    ]
    other = {"blueprint": TRUCK, "base_type": "truck", "wheels": 4, **TRUCK_BOX, "forward_m": 0.0}
    scene = a_scene()
    for probe, text in (
        (None, f"no {PROBE_FILE} lies beside the bag"),
        (a_probe(rows=failed), "the server failed its probe: teleport"),
        (a_probe(rows=failed[1:]), "lacks teleport"),
        (a_probe(version="0.9.15"), "is of CARLA 0.9.15, the server was 0.9.16"),
        (a_probe(bodies=[other]), f"has another box of {TRUCK}, the body of ot1"),
        (a_probe(bodies=[]), f"has no box of {TRUCK}, the body of ot1"),
    ):
        (found,) = words(replace(facts, scene=scene, probe=probe))
        assert text in found
    assert words(facts) == ["the bag holds no record of the server that drew it"]
    stand_in = replace(facts, scene=a_scene(counterpart=True), probe=a_probe())
    assert stand_in.renderer == COUNTERPART
    assert words(stand_in) == [
        "a stand-in for CARLA in tests drew it, which is no evidence of anything"
    ]


def test_each_body_is_disclosed_with_its_box_and_what_it_is_taken_for(facts: Provenance) -> None:
    found = server_disclosures(replace(facts, scene=a_scene(), probe=a_probe()))
    assert found["body of ot1"] == (
        f"{TRUCK}, box 8.47 × 2.89 × 3.83 m, middle -0.25 m ahead and +0.00 m right of its origin; "
        "the run has 9.00 × 2.50 × 3.40 m, so that in the pictures it is 0.53 m shorter, "
        "0.39 m wider, 0.43 m higher"
    )
    assert "0.9.16, map Carla/Maps/Town01 (sha256:a), synchronous, step 0.1 s" in found["CARLA"]
    assert found["camera of CARLA"] == "fov 75"
    assert found["triggers with CARLA"] == (
        "near of ot1: anchor [121.0, 0.0], below_s 3.2, lead_time_s 0.1, not_before_s 4, "
        "type time_to_arrival"
    )
    assert PROBE_FILE in found["probe of CARLA"]


def test_what_stands_beside_the_road_and_is_not_in_the_pictures_is_disclosed(
    facts: Provenance,
) -> None:
    def scenery_text(scenery: list[Any]) -> str:
        assert facts.run is not None
        road = facts.run.road.model_copy(update={"scenery": scenery})
        run = facts.run.model_copy(update={"road": road})
        found = server_disclosures(replace(facts, run=run, scene=a_scene()))
        return found["scenery of CARLA"]

    sign = Sign(type="sign", s_m=10.0, l_m=-5.0, kind="stop")
    house = Building(type="building", s_m=50.0, l_m=20.0, length_m=10.0, width_m=8.0, height_m=6.0)
    assert scenery_text([]) == "its map's own"
    beside = "its map's own; of the run's road it has no actors for 2 × building, 1 × sign"
    assert scenery_text([house, sign, house]) == beside


def test_a_probe_is_found_beside_the_bag(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    assert read_probe(tmp_path / "bag") is None
    write_report(tmp_path / PROBE_FILE, a_probe().report)
    found = read_probe(tmp_path / "bag")
    assert found is not None
    assert found.report == a_probe().report
    (tmp_path / PROBE_FILE).write_text("{}")
    with pytest.raises(InputError, match=PROBE_FILE):
        read_probe(tmp_path / "bag")


def test_an_audit_refuses_what_a_counterpart_drew_and_two_bags_of_one_drive(
    make_bag: Callable[..., Path],
) -> None:
    recordings = [read_recording(make_bag(f"{one}/bag", domain=one)) for one in DOMAINS]
    simulated, physical = recordings[1:]
    told = replace(simulated.provenance, scene=a_scene(counterpart=True))
    recordings[1] = replace(simulated, provenance=told)
    drawn = Redrawing(
        of="run-1",
        of_sha256=told.bag_sha256,
        map_file="Town01.xodr",
        map_sha256="sha256:" + "2" * 64,
        map_said_by="the task",
        frames=4,
        left_out=0,
        software="ssp",
    )
    recordings[2] = replace(physical, provenance=replace(physical.provenance, redrawing=drawn))

    def codes() -> list[set[str]]:
        entries = judge(recordings, load_event("cut_in")[0]).audit.recordings
        assert f"{TRUCK}, box" in entries[1].disclosures["body of ot1"]
        assert entries[1].disclosures["renderer"] == COUNTERPART
        every = [
            [found for r in entry.reasons for found in (r, *r.consequences)] for entry in entries
        ]
        return [{found.code for found in of} for of in every]

    found = codes()
    assert [server.CODE in of for of in found] == [False, True, True]
    assert ["same_recording" in of for of in found][1:] == [False, True]


def test_a_probe_is_of_the_server_that_was_used(facts: Provenance) -> None:
    for address, refused, told in (
        ("", False, False),
        ("gpu7:2000", False, False),
        ("gpu7:2001", True, True),
        # A host may have several names.
        ("10.0.0.7:2000", False, True),
    ):
        one = replace(facts, scene=a_scene(address=address), probe=a_probe())
        assert words(one) == [
            f"{PROBE_FILE} is of gpu7:2000, the server was {address}" for _ in range(refused)
        ]
        assert ("of gpu7:2000: only your word" in server_disclosures(one)["probe of CARLA"]) == told


def test_what_a_server_moved_is_held_against_its_probe_too(facts: Provenance) -> None:
    run = facts.run
    assert run is not None
    moved = replace(facts, run=run.model_copy(update={"plant": "carla", "camera": None}))
    assert words(moved) == ["the bag holds no record of the server that moved it"]
    scene = a_scene().model_dump(by_alias=True)
    ours = {name: scene[name] for name in scene if name in CarlaPlantRecord.model_fields}
    response = dict.fromkeys(
        (
            "throttle_mps2",
            "throttle_lag_s",
            "brake_mps2",
            "brake_lag_s",
            "steer_1pm",
            "steer_lag_s",
        ),
        0.5,
    )
    plant = CarlaPlantRecord.model_validate({**ours, "responses": {"ot1": response}})
    assert words(replace(moved, plant=plant, probe=a_probe())) == []
    (found,) = words(replace(moved, plant=plant))
    assert f"no {PROBE_FILE} lies beside the bag" in found
    (found,) = words(replace(moved, plant=plant.model_copy(update={"counterpart": True})))
    assert found == "a stand-in for CARLA in tests moved it, which is no evidence of anything"
    told = server_disclosures(replace(moved, plant=plant, probe=a_probe()))
    assert "no two such runs are equal" in told["plant"]
    assert "full brake 0.50 m/s^2" in told["moved by CARLA: ot1"]
