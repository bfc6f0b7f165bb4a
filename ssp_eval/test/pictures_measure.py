"""Sound and false recordings by which the limits of pictures against states were chosen.

``python ssp_eval/test/pictures_measure.py RESULTS.jsonl PATH…`` judges crops of recordings, and
what is made of them, and prints the table that stands in docs/audit.md. A PATH is a run's folder, a
bag, a clip of ``ssp spec clip`` with its truth file beside it, or a real clip of ``REAL``. What
RESULTS holds already is not judged again.
"""

from __future__ import annotations

import json
import math
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState, Size
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import Intrinsics, Mounting, intrinsics, shown_box
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.pictures.compare import PictureFigures, compare_pictures, plan_pairs
from ssp_eval.pictures.footage import Footage, Grey, coarse, reduced
from ssp_eval.pictures.repeats import has_many_repeats, repeated_frames, sampled_frames
from ssp_eval.recordings.sight import Moment, Optics
from ssp_ot_controller.camera.frames import steps_per_frame
from ssp_ot_controller.camera.redraw import Redrawing

CROPS = 30
# Sessions with a faster turn are a kind of their own; the others drive straight.
TURNING_RADPS = 0.1
# Boxes of an object that are nearer than this, at 960 px of width, are those of one drive.
NEAR_PX = 5.0
FALSE = 4
EVENTS = ("cut_in", "vru_crossing", "lead_braking", "occluded_crossing")
# Other cameras of a VUT: by how much they are turned to the left of the front camera.
REAR_RAD, SIDE_RAD, CORNER_RAD = math.pi, math.pi / 2.0, math.radians(40.0)
# Real clips: focal length, columns and rows of the vanishing point in px, camera height in m; speed
# in m/s and the car ahead (m ahead, m to the left) as they were read off the pictures.
REAL = {
    "highway_960x540": (862.0, 487.0, 308.0, 1.3, 26.2, None),
    "highway_traffic_1280x720": (1150.0, 690.0, 415.0, 1.3, 31.0, (20.1, -2.9)),
}
Edit = Callable[[Grey, int], Grey]


@dataclass(frozen=True)
class Drive:
    """Frames with their states, of one kind of recording."""

    name: str
    kind: str
    moments: tuple[Moment, ...]
    frames: tuple[Grey, ...]
    optics: Optics
    targets: tuple[str, ...]
    road: Road | None = None
    run: RunSpec | None = None

    def cut(self, from_s: float, to_s: float) -> Drive:
        kept = [k for k, moment in enumerate(self.moments) if from_s <= moment.t_s <= to_s]
        return replace(
            self,
            moments=tuple(self.moments[k] for k in kept),
            frames=tuple(self.frames[k] for k in kept),
        )

    def edited(self, edit: Edit) -> Drive:
        return replace(self, frames=tuple(edit(one, k) for k, one in enumerate(self.frames)))

    def ordered(self, order: Sequence[int]) -> Drive:
        return replace(self, frames=tuple(self.frames[k] for k in order))

    def filmed_by(self, other: Drive, delay_s: float = 0.0, rate: float = 1.0) -> Drive:
        """These states with the frames that another drive has at the same times."""
        times_s = [moment.t_s for moment in other.moments]
        start_s = self.moments[0].t_s
        places = [
            int(np.searchsorted(times_s, start_s + rate * (m.t_s - start_s) + delay_s - 1e-3))
            for m in self.moments
        ]
        last = len(times_s) - 1
        return replace(self, frames=tuple(other.frames[min(max(k, 0), last)] for k in places))


def judge(drive: Drive) -> PictureFigures:
    small = {index: coarse(frame) for index, frame in enumerate(drive.frames)}
    some = sampled_frames(drive.moments, "vut")
    often = has_many_repeats({k: small[k] for k in some}, drive.moments, "vut")
    repeated = repeated_frames(small, drive.moments, "vut") if often else ()
    plan = plan_pairs(drive.moments, drive.optics, "vut", drive.targets, repeated)
    grey = {index: reduced(drive.frames[index]) for index in plan.frame_indices}
    return compare_pictures(Footage(drive.moments, grey, drive.optics, "vut"), plan, drive.road)


def load(path: Path) -> Drive:
    if path.stem in REAL:
        return _real(path)
    return _clip(path) if path.suffix == ".mp4" else _session(path)


def _session(path: Path) -> Drive:
    recording = read_recording(path)
    facts, moments = recording.provenance, recording.moments()
    assert recording.optics is not None
    assert facts.participants is not None
    frames: dict[float, Grey] = {}
    with BagReader(recording.path) as bag:
        zero_ns = facts.session_start_ns
        for jpeg in Frames(bag, absolute(CAMERA_IMAGE)).jpegs():
            zero_ns = jpeg.stamp_ns if zero_ns is None else zero_ns
            grey = cv2.imdecode(np.frombuffer(jpeg.data, np.uint8), cv2.IMREAD_GRAYSCALE)
            frames[round(ns_to_seconds(jpeg.stamp_ns - zero_ns), 6)] = np.asarray(grey, np.uint8)
    kept = [moment for moment in moments if round(moment.t_s, 6) in frames]
    kind = "live" if facts.run is not None and facts.run.mode == "live" else "raster"
    vut = [one.states["vut"] for one in moments if "vut" in one.states]
    if max(abs(state.yaw_rate_radps) for state in vut) >= TURNING_RADPS:
        kind = "turn"
    name = "-".join(path.parts[-3:])
    grey_of = tuple(reduced(frames[round(moment.t_s, 6)]) for moment in kept)
    targets = tuple(facts.participants.targets)
    return Drive(name, kind, tuple(kept), grey_of, recording.optics, targets, facts.road, facts.run)


def _video(path: Path) -> Iterator[Grey]:
    video = cv2.VideoCapture(str(path))
    while True:
        more, image = video.read()
        if not more:
            return
        yield reduced(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8))


def _clip(path: Path) -> Drive:
    truth = json.loads(path.with_suffix(".truth.json").read_text("utf-8"))
    given = {key: value for key, value in truth["camera"].items() if key != "provenance"}
    camera = Camera.model_validate(given)
    mounting = Mounting(camera.forward_m, camera.height_m, camera.pitch_down_rad)
    moments = tuple(
        Moment(row["t_s"], {one["object_id"]: _state(one) for one in row["objects"]})
        for row in truth["frames"]
    )
    optics = Optics(intrinsics(camera), mounting)
    road = Road.model_validate(truth["road"])
    name = f"{path.parts[-3]}-{path.stem}"
    return Drive(name, "clip", moments, tuple(_video(path)), optics, ("ot1",), road)


def _state(row: dict[str, Any]) -> ObjectState:
    words = {
        "object_class": ObjectClass[row["object_class"].upper()],
        "role": Role[row["role"].upper()],
        "size": Size(**row["size"]),
    }
    return ObjectState(**{**row, **words})


def _real(path: Path) -> Drive:
    focal_px, column_px, row_px, height_m, speed_mps, ahead = REAL[path.stem]
    frames = tuple(_video(path))
    height, width = frames[0].shape
    full_px = int(path.stem.split("_")[-1].split("x")[0])
    scale = width / full_px
    lens = Intrinsics(
        width, height, focal_px * scale, focal_px * scale, (width - 1) / 2, (height - 1) / 2
    )
    down = math.atan((lens.cy_px - row_px * scale) / lens.fy_px)
    left = math.atan((column_px * scale - lens.cx_px) / lens.fx_px)
    moments = []
    for k in range(len(frames)):
        t_s = k / 25.0
        places = {"vut": (speed_mps * t_s, 0.0)}
        if ahead is not None:
            places["ot1"] = (speed_mps * t_s + ahead[0], ahead[1])
        moments.append(
            Moment(t_s, {who: _car(who, t_s, at, speed_mps) for who, at in places.items()})
        )
    optics = Optics(lens, Mounting(1.2, height_m, down, 0.0, left))
    targets = () if ahead is None else ("ot1",)
    return Drive(path.stem, "real", tuple(moments), frames, optics, targets)


def _car(who: str, t_s: float, at: tuple[float, float], speed_mps: float) -> ObjectState:
    return ObjectState(
        who,
        ObjectClass.CAR,
        Role.VUT if who == "vut" else Role.OT,
        round(t_s * 1e9),
        *at,
        0.0,
        speed_mps,
        0.0,
        0.0,
        Size(3.6, 0.9, 1.8, 1.45),
    )


def crop(drive: Drive, chance: random.Random) -> Drive:
    """Return some seconds that hold the object's manoeuvre, where there is one."""
    first_s, last_s = drive.moments[0].t_s, drive.moments[-1].t_s
    if drive.kind == "real":
        length_s = min(last_s, chance.uniform(1.4, 6.0))
        from_s = chance.uniform(first_s, last_s - length_s)
        return drive.cut(from_s, from_s + length_s)
    # The manoeuvre is in it: the object's place across the VUT's direction changes by half a metre.
    start_m, at_s = None, first_s
    for moment in drive.moments:
        if {"vut", *drive.targets} <= set(moment.states):
            target = moment.states[drive.targets[0]]
            _, left_m = moment.states["vut"].pose.to_local(target.x_m, target.y_m)
            start_m = left_m if start_m is None else start_m
            if abs(left_m - start_m) > 0.5:
                at_s = moment.t_s
                break
    from_s = max(first_s, at_s - chance.uniform(1.5, 3.0))
    return drive.cut(from_s, from_s + chance.uniform(6.0, 9.0))


def within(chance: random.Random, sigma: float) -> float:
    """Draw a normal number, at most two sigma: what is further off is no sound calibration."""
    return min(max(chance.gauss(0.0, sigma), -2.0 * sigma), 2.0 * sigma)


def disturbed(drive: Drive, chance: random.Random, delay_s: float, noise_m: float) -> Drive:
    """States as another system gives them: late, noisy, with an offset of the object."""
    offset_m = within(chance, noise_m / 2.0), within(chance, noise_m / 2.0)
    moments = []
    for moment in drive.moments:
        states = {}
        for who, state in moment.states.items():
            later = state.extrapolated(state.stamp_ns + round(delay_s * 1e9))
            dx_m, dy_m = (0.0, 0.0) if who == "vut" else offset_m
            states[who] = replace(
                later,
                x_m=later.x_m + dx_m + chance.gauss(0.0, noise_m / 2.0),
                y_m=later.y_m + dy_m + chance.gauss(0.0, noise_m / 2.0),
                yaw_rad=later.yaw_rad + chance.gauss(0.0, 0.004),
            )
        moments.append(Moment(moment.t_s, states))
    return replace(drive, moments=tuple(moments))


def foreign(drive: Drive, chance: random.Random) -> Drive:
    """A drive as somebody else records it: other pictures, states and calibration."""
    quality, gamma = chance.choice([25, 50, 80]), chance.choice([0.6, 1.0, 1.6])
    width_px, sigma = chance.choice([400, 480, 640]), chance.choice([0.0, 2.0, 5.0])
    noise = np.random.default_rng(chance.randrange(1 << 30))

    def edit(grey: Grey, _: int) -> Grey:
        height_px = round(grey.shape[0] * width_px / grey.shape[1])
        small = cv2.resize(grey, (width_px, height_px), interpolation=cv2.INTER_AREA)
        light = 255.0 * (small / 255.0) ** gamma + noise.normal(0.0, sigma, small.shape)
        data = cv2.imencode(
            ".jpg", np.clip(light, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality]
        )[1]
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)

    made = disturbed(drive, chance, chance.uniform(-0.25, 0.25), chance.choice([0.02, 0.1, 0.3]))
    if chance.random() < 0.4:
        made = replace(made, moments=made.moments[::2], frames=made.frames[::2])
    at = made.optics.mounting
    turned = replace(
        at,
        pitch_down_rad=at.pitch_down_rad + within(chance, 0.005),
        yaw_left_rad=at.yaw_left_rad + within(chance, 0.005),
        height_m=at.height_m * chance.uniform(0.95, 1.05),
    )
    return replace(made, optics=replace(made.optics, mounting=turned)).edited(edit)


def repeating(drive: Drive, chance: random.Random) -> Drive:
    """A slower camera whose frames are recorded twice or thrice, as an encoder leaves them."""
    times, noise = chance.choice([2, 3]), np.random.default_rng(chance.randrange(1 << 30))
    sigma = chance.choice([0.0, 0.0, 1.0])
    if times == 3 and drive.moments[1].t_s - drive.moments[0].t_s > 0.07:
        times = 2

    def edit(grey: Grey, _: int) -> Grey:
        return np.clip(grey + noise.normal(0.0, sigma, grey.shape), 0, 255).astype(np.uint8)

    held = drive.ordered([k // times * times for k in range(len(drive.frames))])
    return disturbed(held.edited(edit), chance, chance.uniform(-0.08, 0.08), 0.03)


def live(drive: Drive, chance: random.Random) -> Drive:
    """A live recording as it is; of a session, with late states and lost frames."""
    if drive.kind == "live":
        return drive
    kept = [k for k in range(len(drive.frames)) if chance.random() > 0.04]
    some = replace(
        drive,
        moments=tuple(drive.moments[k] for k in kept),
        frames=tuple(drive.frames[k] for k in kept),
    )
    return disturbed(some, chance, chance.uniform(-0.08, 0.08), 0.03)


def in_a_turn(drive: Drive, chance: random.Random) -> Drive:
    """A session with a turn as it is, as somebody else records it, or of a slower camera."""
    return chance.choice([lambda d, _: d, foreign, repeating])(drive, chance)


def _mirror(grey: Grey, _: int) -> Grey:
    return np.ascontiguousarray(grey[:, ::-1])


def _upside_down(grey: Grey, _: int) -> Grey:
    return np.ascontiguousarray(grey[::-1])


def _filmed_by(drive: Drive, other: Drive) -> Drive:
    return replace(drive.filmed_by(other), optics=other.optics)


def other_camera_view(drive: Drive, yaw_left_rad: float) -> Drive:
    """The pictures of another camera of the same VUT, in the place of the front camera's."""
    run = drive.run
    assert run is not None
    assert run.camera is not None
    redrawing, frames = Redrawing(run), []
    ahead_m = drive.optics.mounting.forward_m
    every = steps_per_frame(run.camera.rate_hz, run.step_s)
    for index, moment in enumerate(drive.moments):
        vut = moment.states.get("vut")
        if vut is None:
            frames.append(drive.frames[index])
            continue
        # The renderer carries its camera ahead of a state; turned, it must stay where it is.
        x_m, y_m = vut.pose.to_parent(
            ahead_m * (1.0 - math.cos(yaw_left_rad)), -ahead_m * math.sin(yaw_left_rad)
        )
        at = replace(vut, x_m=x_m, y_m=y_m, yaw_rad=vut.yaw_rad + yaw_left_rad)
        step = index * every
        scene = redrawing.see(step, vut.stamp_ns, tuple(moment.states.values()), at)
        assert scene is not None
        pixels = redrawing.draw(scene, step).pixels
        frames.append(reduced(np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)))
    return replace(drive, frames=tuple(frames))


def apart_px(one: Drive, other: Drive) -> float:
    """Return how far an object's boxes of two drives lie apart: 95 % by less, at the best shift."""
    times_s = [moment.t_s for moment in other.moments]

    def apart(shift_s: float) -> float:
        found = []
        for moment in one.moments:
            k = int(np.searchsorted(times_s, moment.t_s + shift_s - 1e-3))
            pair = (moment.states, other.moments[min(k, len(times_s) - 1)].states)
            if all({"vut", *one.targets} <= set(states) for states in pair):
                views = (one.optics.view(states["vut"].pose) for states in pair)
                target = one.targets[0]
                boxes = [shown_box(view, s[target]) for view, s in zip(views, pair, strict=True)]
                if boxes[0] is not None and boxes[1] is not None:
                    found.append(float(np.abs(np.subtract(*boxes)).max()))
        return float(np.percentile(found, 95)) if found else math.nan

    return min(apart(shift_s) for shift_s in (-0.2, -0.1, 0.0, 0.1, 0.2))


def falsified(
    drives: Sequence[Drive], k: int, chance: random.Random
) -> Iterator[tuple[str, Drive]]:
    """False recordings, the k-th of each kind that the drives allow."""
    sessions = [one for one in drives if one.kind == "raster" and "without" not in one.name]
    plain = sessions[k * 5 % len(sessions)]
    one = crop(plain, chance)
    n = len(one.frames)
    event = next(name for name in EVENTS if name in plain.name)
    mode = "physical" if "physical" in plain.name else "simulation"
    alike = [s for s in sessions if event in s.name]
    yield "mirrored session", one.edited(_mirror)
    yield "mirrored foreign bag", foreign(one, chance).edited(_mirror)
    yield "mirrored, each frame twice", repeating(one, chance).edited(_mirror)
    slow = one.filmed_by(plain, rate=0.5)
    yield "half speed, each frame twice", slow.ordered([k // 2 * 2 for k in range(n)])
    if real := [drive for drive in drives if drive.kind == "real"]:
        film = real[k % len(real)]
        looped = tuple(film.frames[j * 5 // 2 % len(film.frames)] for j in range(n))
        optics = Optics(film.optics.lens, one.optics.mounting)
        yield "highway clip", replace(one, frames=looped, optics=optics)
    simulated = [s for s in alike if "simulation" in s.name]
    filmed = [s for s in alike if "physical" in s.name]
    if simulated and filmed:
        part = crop(simulated[k % len(simulated)], chance)
        other = filmed[k % len(filmed)]
        seen = replace(part.filmed_by(other), optics=other.optics)
        yield "physical video, states of the simulation", seen
    yield "shifted in time", one.filmed_by(plain, (-1.5, -0.7, 0.7, 1.5)[k % 4])
    yield "reversed", one.ordered(range(n - 1, -1, -1))
    yield "half or double speed", one.filmed_by(plain, rate=(0.5, 2.0)[k % 2])
    yield "one picture", one.ordered([n // 3] * n)
    yield "shuffled", one.ordered(chance.sample(range(n), n))
    yield "upside down", one.edited(_upside_down)
    if others := [s for s in sessions if event not in s.name and mode in s.name]:
        yield "another event, same site", one.filmed_by(others[k % len(others)])
    lens, at = one.optics.lens, one.optics.mounting
    factor = (0.5, 2.0)[k % 2]
    other_lens = replace(lens, fx_px=lens.fx_px * factor, fy_px=lens.fy_px * factor)
    yield "focal length off by 2", replace(one, optics=Optics(other_lens, at))
    turned = replace(at, yaw_left_rad=at.yaw_left_rad + (-0.17, 0.17)[k % 2])
    yield "camera turned by 10 degrees", replace(one, optics=Optics(lens, turned))
    empty = [s for s in drives if "without" in s.name and event in s.name]
    if empty and mode == "simulation":
        yield "object not in the pictures", one.filmed_by(empty[0])
    yield "rear camera for the front one", other_camera_view(one, REAR_RAD)
    side_rad = (-SIDE_RAD, SIDE_RAD)[k % 2]
    yield "side camera for the front one", other_camera_view(one, side_rad)
    corner_rad = (-CORNER_RAD, CORNER_RAD)[k % 2]
    yield "corner camera for the front one", other_camera_view(one, corner_rad)
    if same := [s for s in alike if mode in s.name and s is not plain]:
        other = same[k % len(same)]
        near = "under" if apart_px(one, other) < NEAR_PX else "at least"
        yield f"same plan, another seed, {near} {NEAR_PX:g} px apart", one.filmed_by(other)
    if turns := [drive for drive in drives if drive.kind == "turn"]:
        turn = turns[k * 5 % len(turns)]
        part = crop(turn, chance)
        yield "mirrored turn", part.edited(_mirror)
        yield "mirrored foreign turn", foreign(part, chance).edited(_mirror)
        yield "half or double speed in a turn", part.filmed_by(turn, rate=(0.5, 2.0)[k % 2])


def cases(drives: Sequence[Drive]) -> Iterator[tuple[str, str, str, Callable[[], Drive]]]:
    """Name, group and kind of each recording, and what makes it."""
    sessions = [one for one in drives if one.kind == "raster" and "without" not in one.name]
    for k in range(CROPS):
        for kind in ("raster", "clip", "real", "live", "foreign", "repeating", "turn"):
            fitting = [one for one in drives if one.kind == kind and "without" not in one.name]
            if kind == "turn" and not fitting:
                continue
            source = (fitting or sessions)[k % len(fitting or sessions)]
            chance = random.Random(f"{kind}{k}")

            def made(
                source: Drive = source, kind: str = kind, chance: random.Random = chance
            ) -> Drive:
                part = crop(source, chance)
                made = {"foreign": foreign, "live": live, "repeating": repeating, "turn": in_a_turn}
                return made.get(kind, lambda d, _: d)(part, chance)

            yield f"{kind} {k}", "sound", kind, made
        if k < FALSE:
            for kind, drive in falsified(drives, k, random.Random(f"false{k}")):
                yield f"{kind} {k}", "false", kind, lambda drive=drive: drive


def table(rows: Sequence[dict[str, Any]]) -> None:
    """Print how many recordings of each kind and half there are, and how many are refused."""
    for group, kind in dict.fromkeys((row["group"], row["kind"]) for row in rows):
        some = [row for row in rows if (row["group"], row["kind"]) == (group, kind)]
        refused = Counter(row["half"] for row in some if row["fails"])
        total = Counter(row["half"] for row in some)
        halves = ", ".join(f"{refused[half]} of {total[half]}" for half in (0, 1))
        print(f"{group:6s}{kind:42s} refused {halves}")
        for name in dict.fromkeys(name for row in some for name in row["figures"]):
            given = (row["figures"].get(name) for row in some)
            if found := [figure for figure in given if figure is not None]:
                ends = f"{min(found):.3f} to {max(found):.3f}"
                print(f"          {name:24s} {len(found):3d} judged, {ends}")


def main(results: Path, paths: Sequence[str]) -> None:
    rows = (
        [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    )
    known = {row["id"] for row in rows}
    drives = [load(Path(path)) for path in paths]
    for name, group, kind, make in cases(drives):
        if name in known:
            continue
        found = judge(make())
        row = {
            "id": name,
            "group": group,
            "kind": kind,
            "half": int(name.split()[-1]) % 2,
            "fails": [check.name for check in found.checks if check.state == "fails"],
            "figures": {check.name: check.figure for check in found.checks},
        }
        rows.append(row)
        with results.open("a") as file:
            file.write(json.dumps(row) + "\n")
    table(rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
