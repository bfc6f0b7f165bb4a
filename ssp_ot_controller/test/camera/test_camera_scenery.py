"""Scenery of the map: it is drawn where the map has it, and takes the place of the seeded one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Building, CurvePiece, Lane, Pole, Road, SceneryItem, Sign, Tree
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import project, view_from
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.scenery import item_pose
from ssp_ot_controller.camera.kernels.bend import block_line, build_bend
from ssp_ot_controller.camera.kernels.palettes import PALETTES
from ssp_ot_controller.camera.meshes.roadside import sign
from ssp_ot_controller.camera.renderer.render import Scene, render
from ssp_ot_controller.camera.renderer.scenery import Prop, build_scenery
from ssp_ot_controller.camera.renderer.stage import stage_for
from ssp_ot_controller.camera.storyboards import LaneCounts, clip_junction, clip_road, storyboard
from tests.support.states import object_state

Image = NDArray[np.uint8]
LOOK = Look(noise_sigma=0.0, fog_per_m=0.0)
CAMERA = Camera(width_px=480, height_px=270, hfov_deg=60.0)
CURVES = {
    "straight": [CurvePiece(length_m=200.0)],
    "bend": [
        CurvePiece(length_m=30.0),
        CurvePiece(length_m=100.0, start_curvature_1pm=1 / 80, end_curvature_1pm=1 / 80),
        CurvePiece(length_m=70.0),
    ],
}
HALL = Building(
    type="building", s_m=70.0, l_m=-22.0, yaw_rad=0.3, length_m=20.0, width_m=12.0, height_m=9.0
)
STOP = Sign(type="sign", s_m=45.0, l_m=-5.0, kind="stop")


def road(curve: str, *scenery: SceneryItem) -> Road:
    return Road(
        origin=Start(x_m=500.0, y_m=-80.0, yaw_rad=0.4),
        length_m=200.0,
        pieces=CURVES[curve],
        lanes=[
            Lane(y_m=-1.75, width_m=3.5, direction="forward"),
            Lane(y_m=1.75, width_m=3.5, direction="backward"),
        ],
        sidewalk_left_m=2.0,
        sidewalk_right_m=2.0,
        crossing_x_m=120.0,
        scenery=list(scenery),
    )


def props_of(block: Road, palette: str = "suburb") -> list[Prop]:
    return build_scenery(block, build_bend(block), palette, PALETTES[palette], 5)


def picture(block: Road, at_m: float = 20.0) -> tuple[Image, ObjectState]:
    foot = ReferenceLine.of_road(block).pose(at_m)
    x, y = foot.to_parent(0.0, -1.75)
    car = object_state("vut", ObjectClass.CAR, x, y, foot.yaw_rad, 8.0)
    image: Image = render(Scene(block, car, ()), LOOK, CAMERA, 0, seed=3)
    return image, car


@pytest.mark.parametrize("curve", CURVES)
def test_a_building_has_the_place_and_the_extent_that_the_map_says(curve: str) -> None:
    block = road(curve, HALL)
    prop = props_of(block)[-1]
    pose = item_pose(HALL, block_line(block))
    corners = prop.mesh.corners.reshape(-1, 3).astype(float)
    local = np.array([pose.to_local(x, y) for x, y in corners[:, :2]])
    # The roof hangs over by half a metre at most.
    assert np.abs(local).max(axis=0) == pytest.approx([10.25, 6.25], abs=0.26)
    assert corners[:, 2].max() == pytest.approx(9.0, abs=1e-3)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-3)
    far = np.hypot(corners[:, 0] - prop.x_m, corners[:, 1] - prop.y_m).max()
    assert far <= prop.radius_m + 1e-4


@pytest.mark.parametrize("height", [0.5, 1.0, 2.4, 4.0, 8.0, 40.0])
@pytest.mark.parametrize("width", [0.5, 9.0, 60.0])
def test_buildings_are_as_high_as_the_map_says(height: float, width: float) -> None:
    one = HALL.model_copy(update={"height_m": height, "width_m": width, "l_m": -60.0})
    prop = props_of(road("straight", one))[-1]
    z = prop.mesh.corners[..., 2]
    assert float(z.max() - z.min()) == pytest.approx(height, abs=1e-3)


@pytest.mark.parametrize("palette", sorted(PALETTES))
@pytest.mark.parametrize("curve", CURVES)
def test_the_seed_places_nothing_of_a_kind_that_the_map_has(curve: str, palette: str) -> None:
    bare = len(props_of(road(curve), palette))
    signs = 2 * 2 + 2 if curve == "straight" else None
    with_stop = props_of(road(curve, STOP), palette)
    if signs is not None:  # limits at 30 and 150 m, the crossing ahead of both directions
        assert bare - len(with_stop) + 1 >= signs
    everything = (
        HALL,
        STOP,
        Tree(type="tree", s_m=60.0, l_m=8.0),
        Pole(type="pole", s_m=60.0, l_m=-5.0, lamp=True),
    )
    kept = props_of(road(curve, *everything), palette)
    heights = [float(p.mesh.corners[..., 2].max()) for p in kept[:-4]]
    assert all(h < 1.5 for h in heights)  # hedges, cones and fences


def test_fillers_keep_clear_of_the_maps_buildings() -> None:
    at_the_hedge = HALL.model_copy(update={"l_m": -13.0, "yaw_rad": 0.0, "length_m": 60.0})
    props = props_of(road("straight", at_the_hedge))
    for prop in props[:-1]:
        low = prop.mesh.corners[..., :2].reshape(-1, 2)
        inside = (np.abs(low[:, 0] - 70.0) < 30.0) & (np.abs(low[:, 1] + 13.0) < 6.0)
        assert not inside.any()
    assert len(props) > 20


@pytest.mark.parametrize("palette", sorted(PALETTES))
def test_nothing_stands_on_the_arms_of_a_junction_or_hides_them(palette: str) -> None:
    """The clip's junction at 100 m: nothing up to 14 m around it, and nothing on its arms."""
    counts = LaneCounts(1, 1)
    plain = clip_road(counts)
    crossed = plain.model_copy(update={"junction": clip_junction(counts, 100.0)})
    before, kept = props_of(plain, palette), props_of(crossed, palette)
    assert 20 < len(kept) < len(before)

    def reach_in(props: list[Prop]) -> list[Prop]:
        found = []
        for prop in props:
            x, y = prop.mesh.corners[..., :2].reshape(-1, 2).T
            near = (np.abs(x - 100.0) < 22.0) & (np.abs(y - 1.7) < 22.0)
            on_arm = (np.abs(x - 100.0) < 6.0) & (np.abs(y - 1.7) < 65.0)
            # Lamps reach over the road from where they stand.
            low = prop.mesh.corners[..., 2].reshape(-1) < 2.0
            if ((near | on_arm) & low).any():
                found.append(prop)
        return found

    assert reach_in(before)
    assert reach_in(kept) == []


@pytest.mark.parametrize("palette", sorted(PALETTES))
def test_nothing_stands_on_the_oncoming_lane_of_the_arm_that_the_vut_comes_by(palette: str) -> None:
    """The VUT's road around a ring is one lane wide, y from -1.75 to 1.75; its arm has two."""
    ring = storyboard("roundabout", 1).road

    def on_arm(props: list[Prop]) -> list[Prop]:
        found = []
        for prop in props:
            x, y, z = prop.mesh.corners.reshape(-1, 3).T
            if ((x > 5.0) & (x < 65.0) & (y > -1.75) & (y < 5.25) & (z < 2.0)).any():
                found.append(prop)
        return found

    assert on_arm(props_of(ring.model_copy(update={"junction": []}), palette))
    assert on_arm(props_of(ring, palette)) == []


def test_what_stands_on_the_lanes_is_not_drawn() -> None:
    on_it = HALL.model_copy(update={"l_m": -2.0})
    before = picture(road("straight"))[0]
    assert np.array_equal(picture(road("straight", on_it))[0], before)


@pytest.mark.parametrize("curve", CURVES)
def test_a_stop_sign_is_red_where_it_stands(curve: str) -> None:
    block = road(curve, STOP)
    image, car = picture(block)
    x, y = ReferenceLine.of_road(block).to_map(STOP.s_m, STOP.l_m)
    place = np.array([x, y, 2.5])  # above the ground
    seen = project(view_from(car.pose, CAMERA), place)
    u, v = float(seen.u_px[0]), float(seen.v_px[0])
    b, g, r = (int(c) for c in image[round(v), round(u)])
    assert r > 1.5 * max(b, g)
    assert r > 60
    without = picture(road(curve))[0][round(v), round(u)]
    assert not int(without[2]) > 1.5 * max(int(without[0]), int(without[1]))


def test_signs_show_their_face_to_their_traffic() -> None:
    mesh = sign("stop")
    red = mesh.colours[:, 0, 2] > 2.0 * mesh.colours[:, 0, 1]
    assert red.any()
    assert (mesh.normals[red][:, 0, 0] < -0.99).all()  # towards who drives along x
    for value in (5, 30, 130):
        sign("speed_limit", value)
    meshes = {kind: sign(kind).colours.tobytes() for kind in ("crossing", "stop", "yield", "other")}
    assert len(set(meshes.values())) == 4


def test_a_road_without_scenery_and_one_with_have_stages_of_their_own() -> None:
    bare, full = (stage_for(road("straight", *items), LOOK, 3) for items in ((), (HALL,)))
    assert len(full.static.places) != len(bare.static.places)
    assert stage_for(road("straight", HALL), LOOK, 3) is full
