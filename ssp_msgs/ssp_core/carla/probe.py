"""The probe of a CARLA server: what it does of what a run relies on, measured.

It needs an empty world, takes its tick, and leaves settings, weather and actors as they were.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from ssp_core.carla.acceptance import ServerFacts
from ssp_core.carla.address import CarlaAddress
from ssp_core.carla.blueprints import (
    PEDESTRIAN_PREFIX,
    Blueprint,
    box_problem,
    choose_body,
    is_candidate,
)
from ssp_core.carla.client import CarlaServer
from ssp_core.carla.frame import BodyBox, CarlaPose
from ssp_core.carla.orders import Placement
from ssp_core.carla.pictures import CarlaCamera
from ssp_core.carla.probe_report import CarlaProbeReport, MeasuredBody, Outcome, Row
from ssp_core.carla.sensor import INSTANCES_BLUEPRINT, camera_attributes, instance_attributes
from ssp_core.errors import PeerError
from ssp_core.geometry import FloatArray
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import ObjectClass

STEP_S = 0.05
_CAMERA = Camera(width_px=640, height_px=360)
# A float32 tells 0.06 mm from the next number at 1 km, and 0.01 degrees is 2 mm at 10 m.
_TELEPORT_M, _TURN_DEG = 0.001, 0.01
_GRID = [(x, y) for y in (-10.0, 0.0, 10.0) for x in (-20.0, -10.0, 0.0, 10.0, 20.0)]
_PICTURES = 100
_REPEATED = 10
_TIMED = 100
_DROP_M, _FALL_S = 0.3, 2.0
_BEHIND_M, _ABOVE_M = 12.0, 1.5
_AWAY_M = 5000.0


@dataclass
class _Findings:
    """Everything that a probe has measured so far."""

    rows: list[Row] = field(default_factory=list)
    bodies: list[MeasuredBody] = field(default_factory=list)
    camera: dict[str, str] = field(default_factory=dict)


def probe(
    server: CarlaServer,
    facts: ServerFacts,
    address: CarlaAddress,
    started: datetime,
    say: Callable[[str], None],
) -> CarlaProbeReport:
    """Measure what a server does.

    Args:
        server: accepted, and not taken over yet.
        facts: of an accepted server.
        address: of the server, for the report.
        started: when the probe began, for the report.
        say: takes a line on what comes next.

    Raises:
        PeerError: it stops answering, or can't do what a run can't do without.
    """
    findings = _Findings()
    before = server.settings()
    server.take_over(STEP_S)
    say("measuring bodies")
    blueprints = server.blueprints()
    place = server.start_place()
    findings.bodies = _bodies(server, blueprints, place)
    _tell_bodies(findings)
    boxes = {one.blueprint: one.box for one in findings.bodies if one.box is not None}
    car = choose_body(ObjectClass.CAR, DEFAULT_SIZES[ObjectClass.CAR], blueprints, boxes)
    (actor,) = server.spawn([("ssp_probe", car.blueprint)])
    if isinstance(actor, str):
        raise PeerError(f"CARLA server {address} doesn't spawn {car.blueprint}: {actor}")
    say("placing a body")
    findings.rows.append(_teleport(server, actor, place))
    say("taking pictures")
    behind = _behind(place)
    camera = server.start_camera(camera_attributes(_CAMERA), behind)
    findings.camera = camera.attributes
    _pictures(server, actor, camera, place, behind, findings.rows)
    findings.rows.append(_repeat(server, actor, camera, place))
    say("comparing a box with its picture")
    findings.rows.append(_box_in_picture(server, actor, car.box, place, behind))
    return CarlaProbeReport(
        host=address.host,
        port=address.port,
        version=facts.version,
        client_version=facts.client_version,
        started=started,
        map_name=facts.map_name,
        map_sha256=facts.map_sha256,
        settings=before,
        camera=findings.camera,
        bodies=tuple(findings.bodies),
        rows=tuple(findings.rows),
    )


def _bodies(
    server: CarlaServer, blueprints: list[Blueprint], place: CarlaPose
) -> list[MeasuredBody]:
    boxes = server.measure([one.id for one in blueprints])
    bodies = []
    for one in blueprints:
        box = boxes.get(one.id)
        body = MeasuredBody(blueprint=one.id, base_type=one.base_type, wheels=one.wheels)
        if box is None:
            body = body.model_copy(update={"problem": "the server doesn't spawn it"})
        else:
            numbers = {name: getattr(box, name) for name in BodyBox.__slots__}
            body = body.model_copy(update={**numbers, "problem": box_problem(box)})
        if not body.problem and not one.id.startswith(PEDESTRIAN_PREFIX):
            body = body.model_copy(update={"rests_at_m": _rest_m(server, one.id, place)})
        bodies.append(body)
    return bodies


def _rest_m(server: CarlaServer, blueprint: str, place: CarlaPose) -> float | None:
    """Drop a vehicle at a place and measure where its origin comes to rest above it."""
    (actor,) = server.spawn([("ssp_dropped", blueprint)])
    if isinstance(actor, str):
        return None
    server.step([Placement(actor, replace(place, z_m=place.z_m + _DROP_M))])
    server.set_physics(actor, True)
    for _ in range(math.ceil(_FALL_S / STEP_S)):
        server.tick()
    rest_m = server.pose_of(actor).z_m - place.z_m
    server.destroy([actor])
    return rest_m


def _tell_bodies(findings: _Findings) -> None:
    for object_class in DEFAULT_SIZES:
        word = object_class.name.lower()
        of_class = [
            one
            for one in findings.bodies
            if is_candidate(Blueprint(one.blueprint, one.base_type, one.wheels), object_class)
        ]
        usable = [one for one in of_class if not one.problem]
        left_out = [f"{one.blueprint}: {one.problem}" for one in of_class if one.problem]
        findings.rows.append(
            Row(
                check=f"bodies.{word}",
                outcome=Outcome.PASS if usable else Outcome.FAIL,
                measured=float(len(usable)),
                bound=1.0,
                text="; ".join(left_out) or f"of {len(of_class)} blueprints",
            )
        )
    heights = [one.rests_at_m for one in findings.bodies if one.rests_at_m is not None]
    if heights:
        findings.rows.append(
            Row(
                check="resting_height",
                outcome=Outcome.INFO,
                measured=max(heights, key=abs),
                unit="m",
                text=f"farthest from the ground of {len(heights)} vehicles that fell on it",
            )
        )


def _beside(place: CarlaPose, ahead_m: float, right_m: float, yaw_deg: float = 0.0) -> CarlaPose:
    x, y, _ = place.rotation @ np.array([ahead_m, right_m, 0.0])
    at = replace(place, x_m=place.x_m + float(x), y_m=place.y_m + float(y))
    return replace(at, yaw_deg=math.remainder(place.yaw_deg + yaw_deg, 360.0), pitch_deg=0.0)


def _behind(place: CarlaPose) -> CarlaPose:
    return replace(_beside(place, -_BEHIND_M, 0.0), z_m=place.z_m + _ABOVE_M)


def _teleport(server: CarlaServer, actor: int, place: CarlaPose) -> Row:
    worst_m = worst_deg = 0.0
    for index, (ahead, right) in enumerate(_GRID):
        pose = _beside(place, ahead, right, 24.0 * index)
        server.step([Placement(actor, pose)])
        actual_pose = server.pose_of(actor)
        worst_m = max(
            worst_m,
            math.dist(
                (actual_pose.x_m, actual_pose.y_m, actual_pose.z_m), (pose.x_m, pose.y_m, pose.z_m)
            ),
        )
        worst_deg = max(worst_deg, abs(math.remainder(actual_pose.yaw_deg - pose.yaw_deg, 360.0)))
    fine = worst_m <= _TELEPORT_M and worst_deg <= _TURN_DEG
    text = f"{len(_GRID)} places, each in the frame after; at most {worst_deg:.4f} degrees off"
    return Row(
        check="teleport",
        outcome=Outcome.PASS if fine else Outcome.FAIL,
        measured=worst_m,
        bound=_TELEPORT_M,
        unit="m",
        text=text,
    )


def _pictures(
    server: CarlaServer,
    actor: int,
    camera: CarlaCamera,
    place: CarlaPose,
    behind: CarlaPose,
    rows: list[Row],
) -> None:
    """Take pictures while the camera itself moves: its pose in each must be the tick's."""
    wrong, worst_m = 0, 0.0
    began = time.monotonic()
    for index in range(_PICTURES):
        at = _beside(behind, 0.05 * index, 0.0)
        moved = [Placement(actor, place), Placement(camera.actor, at)]
        picture = server.picture(camera, server.step(moved))
        off_m = math.dist((picture.pose.x_m, picture.pose.y_m), (at.x_m, at.y_m))
        worst_m = max(worst_m, off_m)
        wrong += off_m > _TELEPORT_M
    took_s = time.monotonic() - began
    text = f"of {_PICTURES} pictures that a moving camera took, farthest {worst_m:.4f} m off"
    rows.append(
        Row(
            check="frames",
            outcome=Outcome.FAIL if wrong else Outcome.PASS,
            measured=float(wrong),
            bound=0.0,
            text=text,
        )
    )
    size = f"{_CAMERA.width_px} × {_CAMERA.height_px}"
    rows.append(
        Row(
            check="picture_rate",
            outcome=Outcome.INFO,
            measured=_PICTURES / took_s,
            unit="1/s",
            text=f"ticks with a picture of {size}, awaited",
        )
    )


def _repeat(server: CarlaServer, actor: int, camera: CarlaCamera, place: CarlaPose) -> Row:
    """Take the same pictures twice; their mean difference says how far a run is repeatable."""
    passes: list[list[NDArray[np.uint8]]] = []
    for _ in range(2):
        pictures = []
        for index in range(_REPEATED):
            moved = [
                Placement(actor, _beside(place, 0.5 * index, 0.0)),
                Placement(camera.actor, _behind(place)),
            ]
            pictures.append(server.picture(camera, server.step(moved)).pixels)
        passes.append(pictures)
    differences = [
        float(np.abs(a.astype(np.int16) - b.astype(np.int16)).mean())
        for a, b in zip(*passes, strict=True)
    ]
    return Row(
        check="repeated_pictures",
        outcome=Outcome.INFO,
        measured=max(differences),
        unit="of 255",
        text=f"largest mean difference of {_REPEATED} pictures taken twice",
    )


def projected_rectangle(
    camera: CarlaPose, lens: Camera, pose: CarlaPose, box: BodyBox
) -> tuple[float, float, float, float]:
    """Return the rectangle (left, top, right, bottom) in px around a box that lies before a camera.

    Args:
        camera: pose of the camera.
        lens: focal length and size of the picture, px.
        pose: of the actor that has the box.
        box: of the actor, about its origin, m.
    """
    half = np.array([box.length_m, box.width_m, box.height_m]) / 2.0
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    corners = signs * half + (box.forward_m, box.right_m, box.up_m)
    world: FloatArray = corners @ pose.rotation.T + (pose.x_m, pose.y_m, pose.z_m)
    ahead, right, up = ((world - (camera.x_m, camera.y_m, camera.z_m)) @ camera.rotation).T
    u = (lens.width_px - 1) / 2 + lens.focal_px * right / ahead
    v = (lens.height_px - 1) / 2 - lens.focal_px * up / ahead
    return float(u.min()), float(v.min()), float(u.max()), float(v.max())


def _box_in_picture(
    server: CarlaServer, actor: int, box: BodyBox, place: CarlaPose, behind: CarlaPose
) -> Row:
    """Hold the pixels that a body changes in a picture of instances against its projected box."""
    camera = server.start_camera(instance_attributes(_CAMERA), behind, INSTANCES_BLUEPRINT)
    pose = _beside(place, 0.0, 0.0, 15.0)
    pictures = [
        server.picture(camera, server.step([Placement(actor, at)])).pixels.astype(np.int16)
        for at in (pose, _beside(place, _AWAY_M, 0.0))
    ]
    changed = np.abs(pictures[0] - pictures[1]).max(axis=2) > 0
    if not changed.any():
        return Row(
            check="box_in_picture",
            outcome=Outcome.FAIL,
            text="the body isn't in the picture where it was put",
        )
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    visible_rectangle_px = (columns[0] - 0.5, rows[0] - 0.5, columns[-1] + 0.5, rows[-1] + 0.5)
    expected_rectangle_px = projected_rectangle(behind, _CAMERA, pose, box)
    apart = [abs(a - b) for a, b in zip(visible_rectangle_px, expected_rectangle_px, strict=True)]
    text = "left {:.1f}, top {:.1f}, right {:.1f}, bottom {:.1f}; a body is rounder than its box"
    return Row(
        check="box_in_picture",
        outcome=Outcome.INFO,
        measured=max(apart),
        unit="px",
        text=text.format(*apart),
    )
