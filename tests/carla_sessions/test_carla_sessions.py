"""Sessions in one process that CARLA's client draws: how a server that fails ends them, and which
are refused beforehand.

What is asked of a server and how its answers are judged is the same as in the camera's node.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from ssp_core import names
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from tests.support.carla.catalogue import BODIES
from tests.support.carla.commands import left_as_found, ssp
from tests.support.carla.counterpart import EMPTY_XODR, Behaviour, Counterpart
from tests.support.carla.tasks import MAP, compiled, with_small_pictures

IMAGE = names.absolute(names.CAMERA_IMAGE)
# Before the first frame that counts the camera warms up; the event is some 160 frames long.
AT = 90


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_small_pictures(compiled("cut_in", tmp_path_factory.mktemp("carla") / "task"))


@dataclass(frozen=True)
class Failure:
    """A server that fails.

    Args:
        words: of the reason with which the run ends.
        frames: some were recorded before.
        lives: afterwards, so that it must be as it was found.
    """

    behaviour: Behaviour
    words: str
    frames: bool = True
    lives: bool = True


CARS = frozenset(body.blueprint for body in BODIES if body.kind == "car")
EMPTY = {b.blueprint: replace(b, extent=(1.0, 0.0, 0.8)) for b in BODIES if b.kind == "car"}
FAILURES = {
    "no server": Failure(Behaviour(), "Connection refused; start one", False),
    "another version": Failure(
        Behaviour(version="0.9.15"), "the server is CARLA 0.9.15, the client 0.9.16", False
    ),
    "another map": Failure(Behaviour(xodr=EMPTY_XODR), "compile it for this one", False),
    "foreign actors": Failure(
        Behaviour(foreign=("walker.pedestrian.0001",)), "1 actors of somebody else", False
    ),
    "left frozen": Failure(Behaviour(synchronous=True), "no client ticks it: a client died", False),
    "spawn refused": Failure(
        Behaviour(refused=CARS),
        "has no body for a car: vehicle.mercedes.coupe_2020 (not spawned)",
        False,
    ),
    "empty box": Failure(Behaviour(bodies=EMPTY), "its box is empty: 2.00 × 0.00 × 1.60 m", False),
    "lights stay red": Failure(
        Behaviour(stays_red=True), "1 of its 2 traffic lights don't turn green", False
    ),
    "dies": Failure(Behaviour(exit_at=AT), "CARLA server 127.0.0.1", lives=False),
    "hangs": Failure(Behaviour(stall_at=AT), "no answer within 3 s", lives=False),
    "actor vanishes": Failure(Behaviour(vanish_at=("ot1", AT)), "ot1 is gone"),
    "error in a batch": Failure(
        Behaviour(batch_error_at=AT), "refuses a command for ot1: the actor is busy"
    ),
    "lost picture": Failure(Behaviour(lost=frozenset({AT})), "didn't come within 3 s"),
    "late stream": Failure(Behaviour(late={AT: 2}), "didn't come within 3 s"),
}


@dataclass(frozen=True)
class ProbeEnd:
    """A run and the server that drew it."""

    status: int
    said: str
    folder: Path
    server: Counterpart


@pytest.fixture(scope="module")
def ended(task: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, ProbeEnd]]:
    """All of them, one after the other in one process of CARLA's client."""
    folder = tmp_path_factory.mktemp("ended")
    with pytest.MonkeyPatch.context() as patch, ExitStack() as servers:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        found = {}
        for seed, (name, failure) in enumerate(FAILURES.items()):
            behaviour = failure.behaviour
            if behaviour.xodr == EMPTY_XODR and name != "another map":
                behaviour.xodr = MAP.read_text()
            found[name] = servers.enter_context(Counterpart(behaviour, seed=seed))
        found["no server"].leave()
        told = ssp(
            *(
                (
                    *("run", task, "--in-process", "--record", "--json"),
                    *("--camera", f"carla://{server.address}"),
                    *("--out", folder / name.replace(" ", "_")),
                )
                for name, server in found.items()
            )
        )
        yield {
            name: ProbeEnd(status, text, folder / name.replace(" ", "_"), server)
            for (name, server), (status, text) in zip(found.items(), told, strict=True)
        }


@pytest.mark.carla
@pytest.mark.parametrize("name", FAILURES)
def test_a_server_that_fails_ends_the_run_with_its_reason_and_a_readable_bag(
    name: str, ended: dict[str, ProbeEnd]
) -> None:
    run, failure = ended[name], FAILURES[name]
    assert run.status == 1, run.said
    assert "Traceback" not in run.said
    result = json.loads((run.folder / "result.json").read_text())
    assert result["verdict"] == "invalid_harness"
    (reason,) = [
        one for one in result["reasons"] if one.startswith("participant_lost: front_camera: ")
    ]
    assert failure.words in reason
    bag = run.folder / "bag"
    assert check_bag(bag).ok
    told = json.loads((bag / "verdict.json").read_text())
    assert (told["verdict"], told["reasons"]) == ("invalid_harness", result["reasons"])
    with BagReader(bag) as reader:
        frames = len(list(reader.messages([IMAGE])))
        records = list(reader.messages([names.absolute(names.CAMERA_RENDERER)]))
    assert bool(frames) == bool(records) == failure.frames
    # Of some 160: where the frame is missing the run ends.
    assert frames < AT
    if failure.lives:
        left_as_found(run.server)
    else:
        assert "couldn't be left as it was found" in " ".join(run.said.split())


@pytest.mark.carla
def test_a_recording_is_drawn_anew_on_the_map_of_its_task_alone(
    ended: dict[str, ProbeEnd], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, other = ended["lost picture"].folder, tmp_path / "other.xodr"
    other.write_text(EMPTY_XODR)
    for chart, words in (
        (tmp_path / "none.xodr", "none.xodr: can't be read: No such file"),
        (other, "isn't the map that the run was compiled for, bend.xodr (sha256:"),
    ):
        given = ["--map", str(chart), "--camera", "carla://localhost:2000"]
        assert main(["draw", str(recording), *given, "--out", str(tmp_path / "drawn")]) == 1
        assert words in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == [other]


def refusals(task: Path) -> list[tuple[tuple[object, ...], int, str]]:
    """Commands, their exit status, and words of the refusal."""
    record, camera = ("--in-process", "--record"), ("--camera", "carla://localhost:2000")
    return [
        ((task, "--mode", "realtime", *camera), 1, "in lockstep only: by the wall clock"),
        ((task, "--mode", "live", *camera), 2, "goes with a simulated session"),
        ((task, "--in-process", *camera), 2, "with --in-process that is one with --record"),
        ((task, "--no-camera", *camera), 2, "goes with a simulated session that has a camera"),
        (("cut_in", "--site", "boulevard", *camera), 1, "no CARLA server has that map"),
        (("cut_in", *record, *camera), 1, "no CARLA server has that map"),
        ((task, "--camera", "carla://localhost:99999"), 1, "with a port from 1 to 65534"),
        ((task, "--camera", "carla://"), 1, "is no address of a CARLA server"),
        ((task, "--camera", "blender"), 1, "names neither raster nor a server"),
        ((task, *record, "--plant", "carla://localhost"), 2, "in processes of its own"),
        ((task, *camera, "--plant", "carla://localhost"), 1, "one client ticks a server"),
    ]


def test_runs_that_carla_cannot_draw_are_refused_beforehand(
    task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, wanted, words in refusals(task):
        assert main(["run", *map(str, arguments), "--out", str(tmp_path / "run")]) == wanted
        said = capsys.readouterr().err
        assert words in " ".join(said.split()), arguments
        assert list(tmp_path.iterdir()) == []
