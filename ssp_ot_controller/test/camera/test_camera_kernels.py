"""The renderer's kernels against plain formulas: rays, sums of samples, pixels one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ssp_core.run_file.road import Lane, Road
from ssp_core.run_file.values import Start
from ssp_ot_controller.camera.kernels import compose, ground, sensor
from ssp_ot_controller.camera.kernels.ground import ground_row
from ssp_ot_controller.camera.kernels.palettes import PALETTES
from ssp_ot_controller.camera.kernels.raster import Eye, Triangles, rasterise, rasterise_cover
from ssp_ot_controller.camera.kernels.shading import make_noise, window_mix
from ssp_ot_controller.camera.ring import FIRST_ARM, Ring
from ssp_ot_controller.camera.storyboards import LaneCounts, clip_junction, clip_road, storyboard

Floats = NDArray[np.float64]

ROWS, COLUMNS = 14, 20
LENS = np.array([16.0, 16.0, 9.5, 6.5])  # fx, fy, cx, cy
POSITION, AXES = np.zeros(3), np.eye(3)  # the block's frame is the optical one
# Whole numbers make edges level, upright and through samples; halves of them meet the rays less.
numbers = st.integers(-6, 6).map(lambda i: i / 2)
corner = st.tuples(numbers, numbers, st.integers(-4, 8).map(float))
triangle = st.tuples(corner, corner, corner)


def rays() -> Floats:
    """Shape (ROWS, COLUMNS, 3): directions through the samples."""
    v, u = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
    return np.stack([(u - LENS[2]) / LENS[0], (v - LENS[3]) / LENS[1], np.ones_like(u)], axis=2)


def hits(corners: Floats) -> tuple[Floats, Floats]:
    """Smallest barycentric share and 1 / depth where rays meet a triangle's plane; nan: nowhere."""
    matrix = corners.T
    if abs(np.linalg.det(matrix)) < 1e-9:
        return np.full((ROWS, COLUMNS), np.nan), np.full((ROWS, COLUMNS), np.nan)
    shares = rays() @ np.linalg.inv(matrix).T  # times depth they are the barycentric ones
    inverse = shares.sum(axis=2)
    return shares.min(axis=2), inverse


def draw(corners: Floats) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """1 / depth and cover after drawing triangles of shape (n, 3, 3)."""
    n = len(corners)
    places = corners.astype(np.float32)
    runs = np.array([[0, n]])
    depth = np.zeros((ROWS, COLUMNS), np.float32)
    owner, cover = np.zeros((ROWS, COLUMNS), np.int32), np.zeros((ROWS, COLUMNS), np.uint8)
    mesh = Triangles(places, np.zeros((n, 3, 5), np.float32), np.zeros(n, np.uint8))
    eye = Eye(POSITION, AXES, np.zeros((3, 3)), LENS)
    memory = compose.Buffers().cleared(ROWS // 2, COLUMNS // 2, n)
    rasterise(mesh, runs, eye, 0.0, 0, memory._replace(inverse_depth=depth, owner=owner))
    rasterise_cover(places, runs, eye, memory.triangle, cover)
    return depth, cover


@given(corners=triangle)
@settings(max_examples=100, deadline=None)  # the first call loads the kernels
def test_a_triangle_covers_the_rays_that_meet_it(corners: tuple[tuple[float, ...], ...]) -> None:
    places = np.array(corners)
    share, inverse = hits(places)
    front = np.linalg.det(places) < 0.0
    depth, cover = draw(places[None])
    inside = (share > 1e-9) & (inverse > 0.0) & front
    outside = ~((share > -1e-9) & (inverse > 0.0)) | (not front)
    assert depth[inside] == pytest.approx(inverse[inside], rel=1e-5)
    assert cover[inside].all()
    assert not depth[outside].any()
    assert not cover[outside].any()


@given(middle=st.tuples(numbers, numbers), depths=st.lists(st.integers(1, 8), min_size=5))
@settings(max_examples=60, deadline=None)
def test_neighbours_leave_no_crack(middle: tuple[float, float], depths: list[int]) -> None:
    # Four triangles around a point fill a rectangle larger than the picture, whatever the depths.
    ring = [(-9.0, -9.0), (-9.0, 9.0), (9.0, 9.0), (9.0, -9.0)]
    outer = [(x * z, y * z, float(z)) for (x, y), z in zip(ring, depths, strict=False)]
    centre = (middle[0] * depths[4] / 8, middle[1] * depths[4] / 8, float(depths[4]))
    fan = np.array([(centre, outer[i], outer[(i + 1) % 4]) for i in range(4)])
    if any(np.linalg.det(part) >= 0.0 for part in fan):
        fan = fan[:, ::-1]
    depth, cover = draw(fan)
    assert (depth > 0.0).all()
    assert cover.all()


@given(
    u=st.floats(0.0, 200.0),
    v=st.floats(0.0, 30.0),
    wide=st.floats(0.01, 0.9),
    high=st.floats(0.01, 0.9),
)
@settings(max_examples=60, deadline=None)
def test_windows_are_the_mean_of_their_footprint(
    u: float, v: float, wide: float, high: float
) -> None:
    n = 24
    parts = [(i + 0.5) / n - 0.5 for i in range(n)]
    fine = [
        window_mix(u + a * wide, v + b * high, 1e-4, 1e-4, 0.0)[0] for a in parts for b in parts
    ]
    assert window_mix(u, v, wide, high, 0.0)[0] == pytest.approx(np.mean(fine), abs=0.08)


def test_far_windows_become_one_mean() -> None:
    near = [window_mix(0.1 * i, 0.37 * i, 0.01, 0.01, 0.3) for i in range(4000)]
    far = window_mix(17.0, 4.0, 20.0, 5.0, 0.3)
    assert far[0] == pytest.approx(np.mean([glass for glass, _ in near]), abs=0.03)
    assert far[1] == pytest.approx(0.3 * far[0])


@pytest.mark.parametrize("texture", [False, True])
@pytest.mark.parametrize("yaw_rad", [0.0, 0.4])
def test_blocks_of_ground_equal_single_pixels(texture: bool, yaw_rad: float) -> None:
    road = Road(
        origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
        length_m=200.0,
        lanes=[
            Lane(y_m=0.0, width_m=3.5, direction="forward"),
            Lane(y_m=3.5, width_m=3.5, direction="backward"),
        ],
        sidewalk_left_m=2.0,
        sidewalk_right_m=0.0,
        crossing_x_m=20.0,
    )
    palette = PALETTES["suburb"]
    surface = ground.build_ground(road, palette, texture)
    width, focal_px = 203, 160.0
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    columns = np.array([s, -c, 0.0]) / focal_px
    rows = np.array([0.0, 0.0, -1.0]) / focal_px
    position = np.array([5.0, 0.0, 1.4])
    directions = np.stack([np.array([c, s, 0.0]) - 101.0 * columns, columns, rows])
    noise = make_noise(1)

    def shaded(start: Floats, pixels: int) -> NDArray[np.float32]:
        row, hidden = np.zeros(3 * pixels, np.float32), np.zeros(pixels, np.bool_)
        ground_row(surface, None, noise, position, directions, start, hidden, row)
        return row.reshape(-1, 3)

    for v in (2, 9, 30, 70, 110):
        start = directions[0] + v * directions[2]
        singles = np.concatenate([shaded(start + u * columns, 1) for u in range(width)])
        assert np.abs(shaded(start, width) - singles).max() < (12.0 if texture else 0.01)
        assert np.abs(shaded(start, width) - singles).mean() < (1.0 if texture else 0.001)


def test_rows_of_noise_differ_and_brightness_falls_to_the_corners() -> None:
    grain, width, height = sensor.make_grain(), 64, 40
    light, squares = np.full(3 * width, 200.0, np.float32), sensor.falloff(width)

    def developed(v: int, sigma: float) -> NDArray[np.uint8]:
        out = np.empty(3 * width, np.uint8)
        sensor.develop_row(
            light, squares, v, height, sensor.Film(0.5, sigma, np.uint64(9), grain), out
        )
        return out

    clean = developed(0, 0.0).reshape(-1, 3)
    assert clean[0, 0] == 90
    assert developed(height // 2, 0.0).reshape(-1, 3)[width // 2, 1] == 100
    assert not np.array_equal(developed(3, 4.0), developed(4, 4.0))
    assert np.array_equal(developed(3, 4.0), developed(3, 4.0))


def test_a_junction_is_carriageway_with_a_kerb_around_its_corners() -> None:
    """The clip's junction: arms 3.4 m to each side of x = 100 m, corners with a radius of 6 m."""
    counts = LaneCounts(1, 1)
    plain = clip_road(counts)
    crossed = plain.model_copy(update={"junction": clip_junction(counts, 100.0)})
    palette = PALETTES["suburb"]
    before = ground.build_ground(plain, palette, texture=False)
    surface = ground.build_ground(crossed, palette, texture=False)

    def colour(of: ground.Ground, x_m: float, y_m: float) -> tuple[float, ...]:
        return ground._colour(of, x_m, y_m, 0.02, 0.02, 0.0)

    asphalt = pytest.approx(palette.asphalt, abs=1.0)
    for place in ((98.0, -12.0), (102.0, -30.0), (98.0, 25.0), (100.0, 1.7), (106.0, -2.0)):
        assert colour(surface, *place) == asphalt
        assert place == (100.0, 1.7) or colour(before, *place) != asphalt
    # A corner is a quarter of a circle around (109.4, -7.7), with a kerb of 0.24 m along it.
    middle, half = np.array([109.4, -7.7]), np.sqrt(0.5)
    for radius_m, wanted in ((6.1, palette.asphalt), (5.84, palette.kerb), (5.5, palette.sidewalk)):
        x_m, y_m = middle + radius_m * np.array([-half, half])
        assert colour(surface, x_m, y_m) == pytest.approx(wanted, abs=20.0)
    # The line between the directions ends at the junction, and a stop line lies on the side arm.
    centre = colour(surface, 100.0, -20.0), colour(surface, 100.14, -20.0)
    assert pytest.approx(palette.centre_marking, abs=2.0) in centre
    assert colour(surface, 101.7, -8.5) == pytest.approx(palette.marking, abs=2.0)
    assert colour(surface, 98.3, -8.5) == asphalt
    # Far from it nothing changes.
    for place in ((30.0, 1.7), (30.0, -2.5), (200.0, 0.3), (60.0, 40.0)):
        assert colour(surface, *place) == colour(before, *place)


def test_the_arm_that_the_vut_comes_by_has_its_oncoming_lane_up_to_its_end() -> None:
    """The VUT's road around a ring is one lane; its arm has two, from 60 m before the ring on."""
    palette = PALETTES["suburb"]
    surface = ground.build_ground(storyboard("roundabout", 1).road, palette, texture=False)
    asphalt = pytest.approx(palette.asphalt, abs=1.0)
    for x_m in (10.0, 25.0, 45.0, 60.0):
        colours = [ground._colour(surface, x_m, y_m, 0.02, 0.02, 0.0) for y_m in (0.3, 2.6, 4.4)]
        assert colours == [asphalt] * 3, x_m
        beside = ground._colour(surface, x_m, 6.5, 0.02, 0.02, 0.0)
        assert beside != asphalt, x_m


@pytest.mark.parametrize("towards_deg", [60.0, 90.0, 120.0, 240.0, 270.0, 300.0])
def test_the_island_of_a_ring_is_no_carriageway(towards_deg: float) -> None:
    """The ring's lane has a radius of 14 m and is 4 m wide; inside are a sidewalk and a verge."""
    ring, counts = Ring(mouth_m=50.0, lane_m=3.4), LaneCounts(1, 1)
    road = clip_road(counts).model_copy(update={"junction": ring.roads(60.0)})
    palette = PALETTES["suburb"]
    surface = ground.build_ground(road, palette, texture=False)
    # The first arm comes from the left at a right angle: it lies as far along as the middle does.
    x_m = ring.inward(FIRST_ARM, 0.0).x_m - 1.7
    found = []
    for radius_m in (9.0, 11.0, 14.0):
        x, y = (
            radius_m * np.cos(np.radians(towards_deg)),
            radius_m * np.sin(np.radians(towards_deg)),
        )
        found.append(ground._colour(surface, x_m + x, 1.7 + y, 0.02, 0.02, 0.0))
    asphalt, verge = (pytest.approx(c, abs=1.0) for c in (palette.asphalt, palette.verge))
    assert found[0] == verge
    assert found[1] not in (verge, asphalt)
    assert found[2] == asphalt


def test_blocks_of_pixels_beside_a_junction_equal_single_ones() -> None:
    counts = LaneCounts(1, 1)
    road = clip_road(counts).model_copy(update={"junction": clip_junction(counts, 40.0)})
    surface = ground.build_ground(road, PALETTES["suburb"], texture=False)
    width, focal_px = 203, 160.0
    columns, rows = np.array([0.0, -1.0, 0.0]) / focal_px, np.array([0.0, 0.0, -1.0]) / focal_px
    position = np.array([5.0, 0.0, 1.4])
    directions = np.stack([np.array([1.0, 0.0, 0.0]) - 101.0 * columns, columns, rows])

    def shaded(start: Floats, pixels: int) -> NDArray[np.float32]:
        row, hidden = np.zeros(3 * pixels, np.float32), np.zeros(pixels, np.bool_)
        ground_row(surface, None, make_noise(1), position, directions, start, hidden, row)
        return row.reshape(-1, 3)

    for v in (2, 7, 12, 40):
        start = directions[0] + v * directions[2]
        singles = np.concatenate([shaded(start + u * columns, 1) for u in range(width)])
        assert np.abs(shaded(start, width) - singles).max() < 0.01
