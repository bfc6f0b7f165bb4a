"""Roads that bend: places along the line, the picture of the ground, and what stands beside it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import CurvePiece, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import project, view_from
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.camera.kernels.bend import Bend, build_bend, locate_all, offsets_of
from ssp_ot_controller.camera.kernels.palettes import PALETTES
from ssp_ot_controller.camera.renderer.render import Scene, render
from ssp_ot_controller.camera.renderer.scenery import build_scenery
from ssp_ot_controller.camera.renderer.stage import Detail
from tests.support.states import object_state

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

PLAIN = Detail(scenery=False, texture=False)
LOOK = Look(noise_sigma=0.0, fog_per_m=0.0)
CAMERA = Camera(width_px=480, height_px=270, hfov_deg=60.0)
STRAIGHT = [CurvePiece(length_m=60.0)]


def turn(radius_m: float, length_m: float = 80.0, clothoid_m: float = 30.0) -> list[CurvePiece]:
    """Straight, clothoid, arc, clothoid, straight; + radius turns left."""
    k = 1.0 / radius_m
    arc = CurvePiece(length_m=length_m, start_curvature_1pm=k, end_curvature_1pm=k)
    if not clothoid_m:
        return [*STRAIGHT, arc, *STRAIGHT]
    into = CurvePiece(length_m=clothoid_m, end_curvature_1pm=k)
    out = CurvePiece(length_m=clothoid_m, start_curvature_1pm=k)
    return [*STRAIGHT, into, arc, out, *STRAIGHT]


def road(pieces: list[CurvePiece], walk_m: float = 2.0, yaw_rad: float = 0.4) -> Road:
    return Road(
        origin=Start(x_m=500.0, y_m=-80.0, yaw_rad=yaw_rad),
        length_m=sum(p.length_m for p in pieces) or 200.0,
        pieces=pieces,
        lanes=[
            Lane(y_m=-1.75, width_m=3.5, direction="forward"),
            Lane(y_m=1.75, width_m=3.5, direction="backward"),
        ],
        sidewalk_left_m=walk_m,
        sidewalk_right_m=walk_m,
    )


def car(block: Road, s_m: float, l_m: float = -1.75, object_id: str = "vut") -> ObjectState:
    foot = ReferenceLine.of_road(block).pose(s_m)
    x, y = foot.to_parent(0.0, l_m)
    return object_state(object_id, ObjectClass.CAR, x, y, foot.yaw_rad, 8.0)


def picture(block: Road, s_m: float, *objects: ObjectState, detail: Detail = PLAIN) -> Image:
    image: Image = render(
        Scene(block, car(block, s_m), objects), LOOK, CAMERA, 0, seed=3, detail=detail
    )
    return image


def places(bend: Bend, xy: Floats) -> Floats:
    out = np.empty_like(xy)
    locate_all(bend, xy, out)
    return out


# -- places ---------------------------------------------------------------------------------------


@given(
    radius=st.floats(30.0, 500.0),
    side=st.sampled_from([-1.0, 1.0]),
    length=st.floats(10.0, 60.0),
    clothoid=st.sampled_from([0.0, 20.0, 40.0]),
    share=st.floats(-0.2, 1.2),
    offset=st.floats(-20.0, 20.0),
)
@example(radius=30.0, side=-1.0, length=10.75, clothoid=0.0, share=0.5, offset=0.0)  # half way
@settings(max_examples=60, deadline=None)
def test_a_place_is_found_as_the_exact_transform_has_it(
    radius: float, side: float, length: float, clothoid: float, share: float, offset: float
) -> None:
    block = road(turn(side * radius, length, clothoid))
    exact = ReferenceLine.of_road(block)
    bend = build_bend(block)
    s = share * block.length_m
    x, y = exact.pose(s).to_parent(0.0, offset)
    local = block.origin.pose.to_local(x, y)
    wanted = exact.to_local_many(np.array([[x, y]]))[0]
    if np.isnan(wanted).any():
        return
    found = places(bend, np.array([local]))[0]
    # Where an arc meets a straight the nearest node's circle is off for an eighth of a metre.
    assert found == pytest.approx(wanted, abs=2e-3)


def test_far_out_the_road_goes_on_straight() -> None:
    block = road(turn(50.0))
    bend, line = build_bend(block), ReferenceLine.of_road(block)
    for s, offset in ((block.length_m + 900.0, -3.0), (-700.0, 6.0)):
        x, y = line.pose(s).to_parent(0.0, offset)
        local = block.origin.pose.to_local(x, y)
        assert places(bend, np.array([local]))[0] == pytest.approx((s, offset), abs=1e-6)


def test_beyond_the_centre_of_a_bend_is_no_road() -> None:
    block = road(turn(40.0))
    bend, line = build_bend(block), ReferenceLine.of_road(block)
    x, y = line.pose(100.0).to_parent(0.0, 60.0)
    assert offsets_of(bend, np.array([block.origin.pose.to_local(x, y)]))[0] > 15.0


def test_a_straight_road_has_no_tables() -> None:
    assert build_bend(road([])) is None
    assert build_bend(road(STRAIGHT)) is None
    assert offsets_of(build_bend(road([])), np.array([[3.0, -2.5]])) == pytest.approx([-2.5])


# -- pictures -------------------------------------------------------------------------------------


def test_a_road_of_straight_pieces_is_the_straight_road() -> None:
    pieces = [CurvePiece(length_m=90.0), CurvePiece(length_m=110.0)]
    detail = Detail()
    assert np.array_equal(
        picture(road(pieces), 20.0, detail=detail), picture(road([]), 20.0, detail=detail)
    )


def test_a_road_that_hardly_bends_looks_straight() -> None:
    """The kernel for bends against the one for straight roads: same ground, same footprints."""
    pieces = [CurvePiece(length_m=200.0, start_curvature_1pm=1e-9, end_curvature_1pm=1e-9)]
    textured = Detail(scenery=False)
    a = picture(road(pieces), 20.0, detail=textured).astype(int)
    b = picture(road([]), 20.0, detail=textured).astype(int)
    # Rounding decides where a pixel is on the border of two strips.
    differs = np.abs(a - b).max(axis=2) > 1
    assert differs.mean() < 2e-4


@pytest.mark.parametrize("radius", [60.0, -60.0, 200.0])
def test_markings_follow_the_line(radius: float) -> None:
    """The picture is brighter along the right edge line than half a metre to its left."""
    block = road(turn(radius), walk_m=0.0)
    image = picture(block, 50.0).astype(float).sum(axis=2)
    line, view = ReferenceLine.of_road(block), view_from(car(block, 50.0).pose, CAMERA)
    seen = 0
    for s in np.arange(57.0, 90.0, 1.0):
        edge = [line.pose(float(s)).to_parent(0.0, block.right_edge_m + d) for d in (0.2, 0.7)]
        spots = project(view, [(x, y, 0.0) for x, y in edge])
        u, v = np.round(spots.u_px).astype(int), np.round(spots.v_px).astype(int)
        if not ((u > 1) & (u < 478) & (v < 268)).all():
            continue
        (on, off) = (image[v[i], u[i]] for i in (0, 1))
        seen += 1
        assert on > off + 35.0, f"at {s} m"
    assert seen > 20


def test_the_picture_is_the_same_everywhere_on_an_arc() -> None:
    """No tearing where nodes or cells meet: the arc is the same at every place of it."""
    pieces = [CurvePiece(length_m=300.0, start_curvature_1pm=0.01, end_curvature_1pm=0.01)]
    block = road(pieces)
    first = picture(block, 100.0).astype(int)
    for s in (100.07, 101.3, 117.77):
        other = picture(block, s).astype(int)
        # Sky, paving joints and dashes turn or move on; look at the road's lower half.
        half = np.abs(first - other)[160:, :240].max(axis=2)
        assert np.quantile(half, 0.97) <= 8
        assert (half > 40).mean() < 0.01


def test_a_car_in_its_lane_ahead_covers_the_middle_of_it() -> None:
    block = road(turn(70.0))
    ahead = car(block, 85.0, object_id="ot1")
    with_car, without = picture(block, 55.0, ahead), picture(block, 55.0)
    changed = np.abs(with_car.astype(int) - without.astype(int)).max(axis=2) > 12
    view = view_from(car(block, 55.0).pose, CAMERA)
    spot = project(view, [(ahead.x_m, ahead.y_m, 0.7)])
    u, v = round(float(spot.u_px[0])), round(float(spot.v_px[0]))
    assert changed[v - 4 : v + 4, u - 4 : u + 4].all()
    assert changed.mean() < 0.05


# -- scenery --------------------------------------------------------------------------------------


@pytest.mark.parametrize("palette", ["suburb", "proving_ground", "dusk_city"])
@pytest.mark.parametrize("radius", [45.0, -80.0])
def test_nothing_stands_on_a_road_that_bends(palette: str, radius: float) -> None:
    block = road(turn(radius, length_m=1.2 * abs(radius)))
    props = build_scenery(block, build_bend(block), palette, PALETTES[palette], 5)
    straight = build_scenery(road([]), build_bend(road([])), palette, PALETTES[palette], 5)
    assert len(props) > 0.5 * len(straight)
    line = ReferenceLine(block.origin.pose, block.pieces)
    edges = (block.left_edge_m + block.sidewalk_left_m, block.right_edge_m - block.sidewalk_right_m)
    bent = 0
    for prop in props:
        low = prop.mesh.corners[prop.mesh.corners[..., 2] < 2.0][:, :2].astype(float)
        c, w = math.cos(block.origin.yaw_rad), math.sin(block.origin.yaw_rad)
        xy = low @ np.array([[c, w], [-w, c]]) + [block.origin.x_m, block.origin.y_m]
        offsets = line.to_local_many(xy)[:, 1]
        offsets = offsets[~np.isnan(offsets)]
        assert ((offsets > edges[0]) | (offsets < edges[1])).all()
        bent += abs(prop.y_m) > 70.0
    assert bent > 10  # they went round the bend
