"""The camera of a foreign bag: what can't be is refused by name, what others do is read."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_recordings import INFO, TF, TYPES, TrackDay, camera_info, transform, write_bag

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.world.camera import Mounting
from ssp_eval.importers.camera import CameraSource
from ssp_eval.importers.findings import Findings
from ssp_eval.importers.target import CameraFacts

SIZE = (64, 48)
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
HERE = transform("base_link", "camera_optical", (1.5, 0.0, 1.4), OPTICAL)


def info(k: Sequence[float] | None = None, roi: Sequence[int] = (), **changes: Any) -> Any:
    """A CameraInfo of 64 x 48 px with fx 32."""
    made = camera_info(0, 32.0)
    if k is not None:
        made = replace(made, k=np.array(k))
    if roi:
        x, y, width, height = roi
        part = replace(made.roi, x_offset=x, y_offset=y, width=width, height=height)
        made = replace(made, roi=part)
    return replace(made, **changes)


def k_of(fx: float, fy: float, cx: float, cy: float) -> list[float]:
    return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]


def facts(
    lens: Any, static: Sequence[Any] = (HERE,), mounting: Mounting | None = None, down: bool = False
) -> tuple[CameraFacts, list[str]]:
    source = CameraSource(Path("bag"), "/info", lens, mounting, static, "base_link", 0.0, down)
    findings = Findings()
    with findings.listed(Path("bag")):
        return source.facts("camera_optical", SIZE, findings)


@pytest.mark.parametrize(
    ("lens", "k"),
    [
        (info(), (32, 32, 32, 24)),
        # Of a sensor of 128 x 96 px, binned.
        (
            info(k_of(64, 64, 64, 48), width=128, height=96, binning_x=2, binning_y=2),
            (32, 32, 32, 24),
        ),
        (info(k_of(40, 80, 40, 90), width=64, height=144, binning_y=3), None),
        (info(k_of(32, 96, 32, 72), width=64, height=144, binning_y=3), (32, 32, 32, 24)),
        # Of a sensor of 200 x 100 px, the part from (60, 30) on.
        (
            info(k_of(40, 40, 100, 50), width=200, height=100, roi=(60, 30, 64, 48)),
            (40, 40, 40, 20),
        ),
        # Both: the region first, then binned.
        (
            info(
                k_of(80, 80, 200, 100),
                width=400,
                height=200,
                roi=(136, 52, 128, 96),
                binning_x=2,
                binning_y=2,
            ),
            (40, 40, 32, 24),
        ),
        # A region that is the whole sensor.
        (info(roi=(0, 0, 64, 48)), (32, 32, 32, 24)),
        # Rounded up by the driver.
        (
            info(k_of(64, 64, 63, 48), width=127, height=95, binning_x=2, binning_y=2),
            (32, 32, 31.5, 24),
        ),
        # The principal point a quarter from the edge, focal lengths a tenth apart.
        (info(k_of(32, 29, 17, 35)), (32, 29, 17, 35)),
    ],
)
def test_a_lens_is_that_of_the_frames(lens: Any, k: tuple[float, ...] | None) -> None:
    if k is None:
        with pytest.raises(InputError, match="camera_matrix"):
            facts(lens)
        return
    found = facts(lens)[0].lens
    assert found is not None
    assert (found.fx_px, found.fy_px, found.cx_px, found.cy_px) == pytest.approx(k)
    assert (found.width_px, found.height_px) == SIZE


@pytest.mark.parametrize(
    ("lens", "match"),
    [
        (info(k_of(192, 192, 192, 144)), r"principal point \(192, 144\), outside .* 64x48"),
        (info(k_of(32, 32, 15.9, 24)), "principal point"),
        # Of half the resolution, and of half as much again.
        (info(k_of(16, 16, 16, 12)), r"principal point \(16, 12\)"),
        (info(k_of(48, 48, 48, 36)), "principal point"),
        (info(k_of(32, 32, 32, 36.1)), "principal point"),
        (info(k_of(32, 28, 32, 24)), "fx 32 and fy 28"),
        (info([32, 0, 32, 0, 32, 24, 0, 0, 0]), "last row"),
        (info([32, 0, 32, 0, 32, 24, 0.1, 0, 1]), "last row"),
        (info(k_of(400, 400, 32, 24)), r"field of view of 9\.1 degrees"),
        (info(k_of(2, 2, 32, 24)), r"field of view of 172\.8 degrees"),
        # Binning that is stated, but was applied to the size already.
        (info(binning_x=2, binning_y=2), "frames of 32x24 px, binned 2x2, the camera's have 64x48"),
        (info(k_of(math.nan, 32, 32, 24)), "isn't calibrated"),
        (info(d=np.array([0.1, math.nan, 0.0, 0.0, 0.0])), "distortion that is no number"),
    ],
)
def test_a_lens_that_no_camera_of_these_frames_has_is_refused(lens: Any, match: str) -> None:
    with pytest.raises(InputError, match=match):
        facts(lens)


def placed(xyz: Sequence[float], quaternion: Sequence[float] = OPTICAL, **names: str) -> Any:
    parent, child = names.get("parent", "base_link"), names.get("child", "camera_optical")
    return transform(parent, child, xyz, quaternion)


def turned(degrees: float) -> tuple[float, ...]:
    """The optical axes, turned about the vertical one."""
    half = math.radians(degrees) / 2
    c, s = math.cos(half) / 2, math.sin(half) / 2
    return (s - c, c + s, s - c, c + s)


@pytest.mark.parametrize(
    ("static", "match"),
    [
        ([placed((math.nan, 0, 1.4))], "base_link to camera_optical has a value that is no number"),
        ([placed((math.inf, 0, 1.4))], "no number"),
        ([placed((1.5, 0, 1.4), (0, 0, 0, math.nan))], "no number"),
        ([placed((1.5, 0, 1.4), (0, 0, 0, 0))], "base_link to camera_optical .* norm 0, not 1"),
        ([placed((1.5, 0, 1.4), (-0.51, 0.51, -0.51, 0.51))], r"norm 1\.02"),
        (
            [placed((1.5, 0, 0), (0, 0, 0, 0), child="mast"), placed((0, 0, 1.4), parent="mast")],
            "base_link to mast .* norm 0",
        ),
        (
            [HERE, placed((0.3, 0, 2.9))],
            r"two places of camera_optical on base_link: \(1\.50, 0\.00, 1\.40\) and \(0\.30, "
            r"0\.00",
        ),
        ([HERE, placed((1.515, 0, 1.4))], r"0\.015 m"),
        ([HERE, placed((1.5, 0, 1.4), turned(0.6))], r"0\.6 degrees apart"),
        # By two ways.
        (
            [
                HERE,
                placed((1, 0, 0), (0, 0, 0, 1), child="mast"),
                placed((0, 0, 1.4), parent="mast"),
            ],
            r"0\.500 m",
        ),
        # Said again and again, then otherwise.
        ([HERE] * 64 + [placed((1.5, 0, 1.8))] * 36, r"0\.400 m"),
        ([placed((1.5, 0, 1.4 + k / 1e6)) for k in range(65)], "by more than 64 ways"),
    ],
)
def test_a_place_that_cannot_be_is_refused_and_a_declared_one_settles_it(
    static: Sequence[Any], match: str
) -> None:
    with pytest.raises(InputError, match=match) as caught:
        facts(info(), static)
    assert caught.value.field == "/tf_static"
    assert "--mount" in str(caught.value)
    declared = Mounting(1.0, 1.2, 0.0)
    assert facts(info(), static, declared)[0].mounting == declared


@pytest.mark.parametrize(
    "static",
    [
        [HERE],
        [HERE, HERE],
        [HERE, placed((1.505, 0, 1.4), turned(0.4))],
        [HERE, placed((1.5, 0, 1.4), [-value for value in OPTICAL])],  # the same rotation
        [
            HERE,
            placed((math.nan, 0, 0), child="lidar"),
            placed((1, 2, 3), parent="lidar", child="x"),
        ],
        [placed((1.5, 0, 0), (0, 0, 0, 1), child="mast"), placed((0, 0, 1.4), parent="mast")],
        # A ring elsewhere in the tree.
        [
            HERE,
            placed((1, 0, 0), parent="camera_optical", child="a"),
            placed((1, 0, 0), parent="a"),
        ],
    ],
)
def test_a_place_that_is_said_once_or_twice_is_taken(static: Sequence[Any]) -> None:
    found, notes = facts(info(), static)
    assert found.mounting is not None
    assert (found.mounting.forward_m, found.mounting.height_m) == pytest.approx(
        (1.5, 1.4), abs=0.01
    )
    assert not any("normalised" in note for note in notes)


def test_transforms_that_lead_elsewhere_are_not_combined() -> None:
    """A tree that doesn't end at the VUT has 300 to the fourth power ways, which aren't gone."""
    names = ("camera_optical", "a", "b", "c", "elsewhere")
    static = [
        placed((k, 0, 0), child=child, parent=parent)
        for child, parent in pairwise(names)
        for k in range(300)
    ]
    found, notes = facts(info(), static)
    assert found.mounting is None
    assert "doesn't lead from camera_optical to base_link" in notes[0]
    assert facts(info(), [*static, HERE])[0].mounting is not None


def test_a_rotation_that_is_nearly_one_is_normalised_and_said() -> None:
    found, notes = facts(info(), [placed((1.5, 0, 1.4), [1.005 * value for value in OPTICAL])])
    assert found.mounting is not None
    assert found.mounting.pitch_down_rad == pytest.approx(0.0, abs=1e-9)
    assert any("norm 1.0050, and was normalised" in note for note in notes)


def test_a_place_in_a_frame_that_faces_down_is_turned() -> None:
    # Forward, right, down: the camera looks ahead, its x axis leads to the right.
    frd = (0.5, 0.5, 0.5, 0.5)
    found, _ = facts(info(), [placed((1.5, 0.2, -1.4), frd)], down=True)
    assert found.mounting is not None
    place = found.mounting
    assert (place.forward_m, place.left_m, place.height_m) == pytest.approx((1.5, -0.2, 1.4))
    assert (place.pitch_down_rad, place.yaw_left_rad) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_bags_own_places_and_lens_count_as_they_are_in_the_clip(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A second place after the clip doesn't count; one before it, or in it, does."""
    ns = day.zero_ns

    def tree(xyz: Sequence[float]) -> Any:
        return TYPES.types[TF](transforms=[transform("base_link", "camera_optical", xyz, OPTICAL)])

    more = [
        ("/info", INFO, ns, camera_info(ns, 32.0)),
        ("/info", INFO, ns + 2 * 10**9, camera_info(ns, 40.0)),
        ("/tf_static", TF, ns, tree((1.5, 0, 1.4))),
        ("/tf_static", TF, ns + 4 * 10**9, tree((0.3, 0, 2.9))),
    ]
    source = write_bag(tmp_path / "day", [*day.messages(), *more])
    options = (
        "--vut",
        "/vut/odom",
        "--object",
        "ot1=/ot1/odom:car",
        "--camera",
        "/cam",
        "--camera-info",
        "/info",
        "--domain",
        "physical",
    )
    said = refused("import-bag", source, *options, "--out", tmp_path / "out")
    assert "/tf_static: gives two places" in said
    out = ["--start", "2.5", "--end", "3.5", "--out", str(tmp_path / "out")]
    assert main(["import-bag", str(source), *options, *out]) == 0
    with BagReader(tmp_path / "out") as reader:
        (kept,) = reader.messages(["/ssp/vut/front_camera/camera_info"])
        assert reader.decode(kept).k[0] == 40.0
    capsys.readouterr()
