"""ssp import-bag: what a track day's bag holds is measured, and nothing else (METHOD 4.3)."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import pytest
from foreign_recordings import (
    INFO,
    JPEG,
    RAW,
    TF,
    TYPES,
    Message,
    TrackDay,
    camera_info,
    imported,
    jpeg,
    number_of,
    raw,
    starts,
    transform,
    truth,
    write_bag,
)

from ssp_core.bag import BagReader
from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.site import find_shipped
from ssp_scenario_manager.spec.load import load_event
from ssp_scenario_manager.spec.log_file import read_log
from ssp_vla_bridge.core.camera import mounting_of

IMAGE = "/ssp/vut/front_camera/image/compressed"
OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")
DECLARED = (
    "--domain", "physical", "--declared-by", "A. Engineer", "--declared-on", "2026-03-01",
    "--place", "north track",
)  # fmt: skip


@pytest.fixture(scope="module")
def bag(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The track day as an MCAP bag."""
    return write_bag(tmp_path_factory.mktemp("day") / "bag", day.messages())


def run(bag: Path, out: Path, *options: object) -> int:
    return main(["import-bag", str(bag), *OBJECTS, *map(str, options), "--out", str(out)])


@pytest.mark.parametrize("sqlite", [False, True])
@pytest.mark.parametrize(("make_image", "image_type"), [(jpeg, JPEG), (raw, RAW)])
def test_the_event_is_the_sources_own(
    day: TrackDay, tmp_path: Path, sqlite: bool, make_image: Any, image_type: str
) -> None:
    source = write_bag(tmp_path / "day", day.messages(make_image, image_type), sqlite=sqlite)
    out = tmp_path / "rec"
    assert run(source, out, *DECLARED, "--site", "boulevard") == 0
    event, provenance = imported(out)
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)
    assert provenance.participants is not None
    assert dict(provenance.participants.targets) == {"ot1": "car"}
    assert provenance.road is not None
    assert [(lane.y_m, lane.direction) for lane in provenance.road.lanes] == [
        (0.0, "forward"), (3.5, "forward"), (7.0, "backward"), (10.5, "backward"),
    ]  # fmt: skip
    assert provenance.domain_said_by == "declared by A. Engineer, 2026-03-01, north track"
    with BagReader(out) as reader:
        numbers = [
            number_of(cv2.imdecode(reader.decode(m).data, cv2.IMREAD_COLOR))
            for m in reader.messages([IMAGE])
        ]
    assert numbers == list(range(101))


def test_import_json_holds_sources_declarations_and_the_road_by_hash(
    bag: Path, tmp_path: Path
) -> None:
    out = tmp_path / "rec"
    log = ("--log-by", "B. Safety", "--log-on", "2026-03-02", "--safety-abort", "no",
           "--identity-switch", "no", "--site-change", "none")  # fmt: skip
    assert run(bag, out, *DECLARED, *log, "--site", "boulevard", "--event", "cut_in") == 0
    with BagReader(out) as reader:
        record = json.loads(reader.attachment("import.json") or b"")
        site = reader.attachment("site.yaml")
        event = reader.attachment("event.yaml")
    (file,) = bag.glob("*.mcap")
    name, version = "cut_in", load_event("cut_in")[1]
    assert record["schema"] == "ssp.import/2"
    assert record["source"] == {
        "name": "bag", "sha256": sha256_file(file), "kind": "bag", "clock": "header",
        "topics": {"vut": "/vut/odom", "ot1": "/ot1/odom", "camera": "/cam"},
    }  # fmt: skip
    assert record["crop"] == {"start_s": 0.0, "end_s": 10.0}
    assert (record["scenario"], record["event_version"]) == (name, version)
    assert record["log"] == {
        "by": "B. Safety", "on": "2026-03-02", "safety_abort": False, "identity_switch": False,
        "site_changes": [],
    }  # fmt: skip
    assert record["site"]["sha256"] == sha256_file(find_shipped("boulevard", "site"))
    assert record["site"]["block"] == "main"
    assert site == find_shipped("boulevard", "site").read_bytes()
    assert event == find_shipped("cut_in", "event").read_bytes()
    (entry,) = read_log(tmp_path / "rec.log.jsonl")
    assert (entry.kind, entry.who, entry.subject) == ("source", "ssp import-bag", "cut_in")
    assert entry.details["declared"] == record["log"]


def test_what_nobody_declares_stays_unknown(bag: Path, tmp_path: Path) -> None:
    assert run(bag, tmp_path / "rec", "--domain", "physical") == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert (provenance.imported.log, provenance.imported.declaration) == (None, None)
    assert (provenance.road, provenance.camera) == (None, "unknown")
    assert provenance.domain_said_by == "declared by nobody"


def test_the_camera_is_that_of_camera_info_and_static_transforms(
    day: TrackDay, tmp_path: Path
) -> None:
    level = (-0.5, 0.5, -0.5, 0.5)  # optical axes in a body frame, REP 103
    down = (0.0, math.sin(0.05), 0.0, math.cos(0.05))
    chain = TYPES.types[TF](
        transforms=[
            transform("base_link", "camera", (1.5, 0.1, 1.4), down),
            transform("camera", "camera_optical", (0.0, 0.0, 0.0), level),
        ]
    )  # fmt: skip
    more: list[Message] = [
        ("/info", INFO, day.zero_ns, camera_info(day.zero_ns, 32.0)),
        ("/tf_static", TF, day.zero_ns, chain),
    ]
    source = write_bag(tmp_path / "day", [*day.messages(), *more])
    out = tmp_path / "rec"
    assert run(source, out, "--domain", "physical", "--camera-info", "/info",
               "--reference", "vut=0.5") == 0  # fmt: skip
    with BagReader(out) as reader:
        mount = reader.decode(next(iter(reader.messages(["/ssp/vut/front_camera/mount"]))))
        info = reader.decode(next(iter(reader.messages(["/ssp/vut/front_camera/camera_info"]))))
        record = json.loads(reader.attachment("import.json") or b"")
    found = mounting_of(mount.transform)
    # The poses are of a point half a metre ahead of the rear axle.
    assert (found.forward_m, found.left_m, found.height_m) == pytest.approx((2.0, 0.1, 1.4))
    assert found.pitch_down_rad == pytest.approx(0.1)
    assert info.k.tolist() == pytest.approx([32, 0, 32, 0, 32, 24, 0, 0, 1])
    assert record["camera"]["provenance"] == "measured"
    assert record["camera"]["hfov_deg"] == pytest.approx(90.0)
