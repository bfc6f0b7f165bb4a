"""Tasks on a map that a CARLA server can have, and the states of their sessions."""

from __future__ import annotations

from pathlib import Path

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.files.writing import write_text
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.compile.task import RUN_FILE, load_task
from ssp_scenario_manager.maps.site import LIBRARY

MAP = LIBRARY / "maps" / "bend.xodr"
BLOCK = "road 1 forward [0-312 m]"


def compiled(event: str | Path, folder: Path) -> Path:
    """The task of an event, by name or K* file, on the map's straight road."""
    place = ("--map", str(MAP), "--choose", BLOCK, "--who", "A. Tester")
    assert main(["compile", str(event), "--target", "sumo", *place, "--out", str(folder)]) == 0
    assert load_task(folder).place.kind == "opendrive"
    return folder


def with_small_pictures(task: Path) -> Path:
    """The task with pictures that just hold what the counterpart of a server writes into them."""
    run = load_run(task / RUN_FILE)
    assert run.camera is not None
    camera = run.camera.model_copy(update={"width_px": 336, "height_px": 192})
    small = run.model_copy(update={"camera": camera})
    write_text(task / RUN_FILE, small.model_dump_json(by_alias=True, indent=1) + "\n")
    return task


def states(bag: Path, object_id: str) -> dict[int, bytes]:
    """States of the run by their number; before and after it they are sent as often as there
    was time.
    """
    topic = f"/ssp/{object_id}/state"
    with BagReader(bag) as reader:
        sent = list(reader.messages([topic]))
        numbered = [(reader.decode(one).sequence, bytes(one.data)) for one in sent]
    return {number: data for number, data in reversed(numbered) if number > 1}


def equal_states(one: Path, other: Path, objects: tuple[str, ...]) -> None:
    """The states of two bags are equal, byte by byte."""
    for object_id in objects:
        theirs, mine = states(one, object_id), states(other, object_id)
        both = theirs.keys() & mine.keys()
        assert len(both) > 500
        assert {number: theirs[number] for number in both} == {n: mine[n] for n in both}
