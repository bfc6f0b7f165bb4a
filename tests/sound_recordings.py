"""Sound recordings of each kind by seeds: what judges those of others must refuse none of them.

``PYTHONPATH=. .venv/bin/python tests/sound_recordings.py [SEEDS]`` prints, for each kind, how many
were refused (docs/importing.md). Drives are those of sessions in one process with other speeds.
Sessions are judged by their states; bags and videos of others are imported by the command.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "ssp_eval" / "test" / "imports"))

from foreign_recordings import (
    FIX,
    ODOMETRY,
    TYPES,
    Message,
    TrackDay,
    header,
    picture,
    write_bag,
    write_frames,
    write_table,
)

from ssp_core.cli import main as ssp
from ssp_core.geodesy import Datum, Place
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import LinkDisturbance
from ssp_eval.audit.evidence.history import find_switches
from ssp_eval.importers.contradictions import Course, contradictions
from ssp_eval.recordings.states import Sighting
from ssp_scenario_manager.run.in_process import Record, run_in_process
from tests.support.events.adaptation import base

MEASURED = LinkDisturbance(
    position_noise_m=0.02,
    speed_noise_mps=0.03,
    state_jitter_s=0.01,
    state_loss=0.02,
    reorder=0.02,
)
RATES_HZ = (10, 25, 50)
ORIGIN = (57.7, 12.9)


@lru_cache(maxsize=1)
def session(seed: int) -> Record:
    """A session of a seed, the pedestrian's or the car's, with a speed of its own."""
    run = base("cut_in" if seed % 2 else "vru_crossing")
    cruise_mps = run.driver.cruise_mps * (0.9 + 0.005 * seed)
    driver = run.driver.model_copy(update={"cruise_mps": cruise_mps})
    changes = {"seed": seed, "driver": driver, "disturbance": MEASURED}
    return run_in_process(run.model_copy(update=changes))[1]


# -- sessions -----------------------------------------------------------------------------------


def course_of(states: Sequence[ObjectState]) -> Course:
    """The states as an import holds them: in the order of their stamps, each stamp once."""
    by_stamp = {state.stamp_ns: state for state in states}
    kept = [by_stamp[stamp_ns] for stamp_ns in sorted(by_stamp)]
    places = np.array([(state.x_m, state.y_m) for state in kept])
    times_s = np.array([1e-9 * (state.stamp_ns - kept[0].stamp_ns) for state in kept])
    yaws, speeds = (
        np.array([getattr(state, name) for state in kept]) for name in ("yaw_rad", "speed_mps")
    )
    return Course(kept[0].object_class, times_s, places, places, yaws, speeds)


def sightings_of(who: str, states: Sequence[ObjectState]) -> list[Sighting]:
    return [
        Sighting(
            1e-9 * state.stamp_ns,
            who,
            state.object_id,
            state.object_class.word,
            state.x_m,
            state.y_m,
            state.speed_mps,
        )
        for state in sorted(states, key=lambda state: state.stamp_ns)
    ]


def of_session(seed: int, _: Path, *, is_live: bool) -> str:
    """Return the contradictions in a session's states.

    The states are true, or, in a live session, as they arrive: to 2 cm, late, with losses.
    """
    record = session(seed)
    found: list[object] = []
    for who in ("vut", "ot1"):
        states = record.arrived(who) if is_live else record.truths(who)
        found += contradictions(course_of(states))
        seen = sightings_of(who, states)
        if len(states) <= 100 or max(b.t_s - a.t_s for a, b in pairwise(seen)) >= 0.5:
            found.append(f"{who}: {len(states)} states")
        found += find_switches(seen, [who], [], seen[0].t_s, seen[-1].t_s)
    return "; ".join(map(str, found))


# -- recordings of others -----------------------------------------------------------------------


def day_of(seed: int) -> TrackDay:
    """The session's drive as another system measures it: at its rate, with its noise."""
    random, record = np.random.default_rng(seed), session(seed)
    every = 50 // RATES_HZ[seed % len(RATES_HZ)]
    states: dict[str, list[ObjectState]] = {}
    for who in ("vut", "ot1"):
        true = sorted(record.truths(who), key=lambda state: state.stamp_ns)[::every]
        noise = random.normal(0.0, (0.02, 0.02, 0.005, 0.05), (len(true), 4))
        states[who] = [
            replace(
                state,
                stamp_ns=state.stamp_ns - true[0].stamp_ns,
                x_m=state.x_m + x,
                y_m=state.y_m + y,
                yaw_rad=state.yaw_rad + yaw,
                speed_mps=state.speed_mps + v,
            )
            for state, (x, y, yaw, v) in zip(true, noise, strict=True)
        ]
    return TrackDay(states)


def imported(verb: str, source: Path, folder: Path, *options: str) -> str:
    """Return the reasons for which an import refuses the recording; empty: it takes it."""
    told = io.StringIO()
    command = (verb, str(source), "--domain", "physical", "--out", str(folder / "out"), *options)
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
        status = ssp(list(command))
    return told.getvalue() if status else ""


def as_bag(
    seed: int, folder: Path, change: Callable[[Message], Message], *options: str, sqlite: bool
) -> str:
    day, random = day_of(seed), np.random.default_rng(1000 + seed)
    delay_ns = round(random.uniform(0.0, 0.1) * 1e9)
    messages = [change(one) for one in day.messages(delay_ns=delay_ns)]
    bag = write_bag(folder / "day", messages, sqlite=sqlite)
    kind = "car" if seed % 2 else "pedestrian"
    wanted = ("--vut", "/vut/odom", "--object", f"ot1=/ot1/odom:{kind}", "--camera", "/cam")
    return imported("import-bag", bag, folder, *wanted, *options)


def foreign(seed: int, folder: Path, *, sqlite: bool) -> str:
    return as_bag(seed, folder, lambda one: one, sqlite=sqlite)


def as_fix(message: Message) -> Message:
    """The place of an Odometry as a receiver gives it."""
    if message[1] != ODOMETRY:
        return message
    at, stamp = message[3].pose.pose.position, message[3].header.stamp
    place = Datum(Place(*ORIGIN)).to_place(at.x, at.y)
    fix = TYPES.types[FIX](
        header=header(stamp.sec * 10**9 + stamp.nanosec, "gps"),
        status=TYPES.types["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
        latitude=place.latitude_deg,
        longitude=place.longitude_deg,
        altitude=place.altitude_m,
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )
    return (message[0], FIX, message[2], fix)


def gnss(seed: int, folder: Path) -> str:
    origin = ",".join(map(str, ORIGIN))
    return as_bag(seed, folder, as_fix, "--datum", origin, sqlite=False)


def clip(seed: int, folder: Path) -> str:
    """A film whose pictures change with the VUT's way, and the table of its states."""
    day = day_of(seed)
    table = write_table(folder / "states.csv", day.states)
    ones = day.states["vut"]
    stamps_ns = [one.stamp_ns for one in ones]
    way_m = np.cumsum(
        [0.0, *(abs(b.speed_mps) * 1e-9 * (b.stamp_ns - a.stamp_ns) for a, b in pairwise(ones))]
    )
    shown = (int(4.0 * np.interp(at_ns, stamps_ns, way_m)) % 256 for at_ns in day.frames_ns)
    video = write_frames(folder / "clip.avi", [picture(k) for k in shown])
    return imported("import-video", video, folder, "--states", str(table), "--hfov-deg", "90")


KINDS: dict[str, Callable[[int, Path], str]] = {
    "raster": lambda seed, folder: of_session(seed, folder, is_live=False),
    "live": lambda seed, folder: of_session(seed, folder, is_live=True),
    "clip with a table": clip,
    "foreign MCAP": lambda seed, folder: foreign(seed, folder, sqlite=False),
    "foreign SQLite": lambda seed, folder: foreign(seed, folder, sqlite=True),
    "GNSS alone": gnss,
}


def refusal(kind: str, seed: int) -> str:
    """Return the reason that refuses the recording of a kind and a seed; empty: nothing does."""
    with tempfile.TemporaryDirectory() as folder:
        return KINDS[kind](seed, Path(folder))


def main(seeds: int) -> None:
    refused = dict.fromkeys(KINDS, 0)
    for seed in range(seeds):
        for kind in KINDS:
            if why := refusal(kind, seed):
                refused[kind] += 1
                print(f"{kind} {seed}: {why}", flush=True)
    for kind, count in refused.items():
        print(f"{kind:20s} {count} of {seeds} refused", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 30)
