"""Ground-truth boxes: where objects are, what hides them, and that no request holds them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import view_from
from ssp_eval.labels.boxes import boxes, boxes_of_truth
from ssp_eval.labels.cli import labels

CAMERA = Camera(
    width_px=640, height_px=480, hfov_deg=90.0, forward_m=2.0, height_m=1.5, pitch_down_rad=0.0
)


def thing(object_id: str, object_class: ObjectClass, x_m: float, y_m: float = 0.0) -> ObjectState:
    role = Role.VUT if object_id == "vut" else Role.OT
    size = DEFAULT_SIZES[object_class]
    return ObjectState(object_id, object_class, role, 0, x_m, y_m, 0.0, 0.0, 0.0, 0.0, size)


VUT = thing("vut", ObjectClass.CAR, 0.0)
VIEW = view_from(VUT.pose, CAMERA)


def test_boxes_come_nearest_first_and_without_the_carrier() -> None:
    far, near = thing("a", ObjectClass.BUS, 60.0, 5.0), thing("b", ObjectClass.CAR, 12.9)
    found = boxes(VIEW, [far, VUT, near], "vut")
    assert [o.object_id for o in found] == ["b", "a"]
    assert [o.object_class for o in found] == ["car", "bus"]
    # Its rear end is 10 m ahead of the camera, as high as the camera, and 1.8 m wide.
    assert found[0].box_px == pytest.approx((290.7, 239.5, 348.3, 287.5))
    assert found[0].distance_m == pytest.approx(10.9)
    assert found[0].clear_share == 1.0


def test_what_is_hidden_or_outside_has_no_box() -> None:
    truck, hidden = thing("t", ObjectClass.TRUCK, 20.0), thing("p", ObjectClass.PEDESTRIAN, 60.0)
    behind, aside = thing("b", ObjectClass.CAR, -20.0), thing("s", ObjectClass.CAR, 10.0, 40.0)
    assert [o.object_id for o in boxes(VIEW, [VUT, truck, hidden, behind, aside], "vut")] == ["t"]
    half = thing("p", ObjectClass.CAR, 40.0, 2.5)
    shown = {o.object_id: o for o in boxes(VIEW, [VUT, truck, half], "vut")}
    assert 0.0 < shown["p"].clear_share < 1.0


def truth_file(path: Path, camera: object) -> Path:
    def record(state: ObjectState) -> dict[str, object]:
        return {
            "object_id": state.object_id,
            "object_class": state.object_class.word,
            "role": state.role.name.lower(),
            "x_m": state.x_m,
            "y_m": state.y_m,
            "yaw_rad": 0.0,
            "speed_mps": 0.0,
            "size": {
                "front_m": state.size.front_m,
                "rear_m": state.size.rear_m,
                "width_m": state.size.width_m,
                "height_m": state.size.height_m,
            },
        }

    value = {
        "schema": "ssp.truth/1",
        "scenario": "cut_in",
        "domain": "synthetic",
        "fps": 10.0,
        "frames": [
            {
                "t_s": 0.1 * k,
                "objects": [record(VUT), record(thing("ot1", ObjectClass.CAR, 12.9 + k))],
            }
            for k in range(3)
        ],
        "camera": camera,
    }
    path.write_text(json.dumps(value))
    return path


def test_a_clips_truth_gives_a_line_per_frame(tmp_path: Path) -> None:
    stated = CAMERA.model_dump(mode="json") | {"provenance": "declared"}
    truth, out = truth_file(tmp_path / "clip.truth.json", stated), tmp_path / "new" / "boxes.jsonl"
    done = CliRunner().invoke(labels, ["boxes", str(truth), "--out", str(out)])
    assert done.exit_code == 0, done.output
    first, *frames = [json.loads(line) for line in out.read_text().splitlines()]
    assert first == {"schema": "ssp.boxes/1", "source": "clip.truth.json", "frames": 3}
    assert [frame["t_s"] for frame in frames] == [0.0, 0.1, 0.2]
    assert [frame["objects"][0]["distance_m"] for frame in frames] == [10.9, 11.9, 12.9]
    assert frames[0]["objects"][0]["box_px"] == [290.7, 239.5, 348.3, 287.5]
    again = CliRunner().invoke(labels, ["boxes", str(truth), "--out", str(out)])
    assert isinstance(again.exception, InputError)
    assert "--force" in str(again.exception)


def test_a_truth_that_states_half_of_its_camera_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"camera.width_px: .*state width_px, height_px"):
        list(boxes_of_truth(truth_file(tmp_path / "clip.truth.json", {"hfov_deg": 75.0})))
