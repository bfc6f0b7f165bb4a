"""Reading a large map into blocks, against a bare parse of the same XML.

`python topology.py` makes a city of some thousand roads; `python topology.py MAP` takes a map file.
Each reading has a process of its own, so that its peak memory is its own.
"""

from __future__ import annotations

import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import defusedxml.ElementTree as safe_xml
from measure import report

from ssp_scenario_manager.maps.load import load_library

SIDE = 20  # junctions along each side of the city
BLOCK_M = 200.0
HALF_M = 12.0  # from a junction's middle to its arms
ROUNDS = 3

WIDTH = '<width sOffset="0" a="{:g}" b="0" c="0" d="0"/>'
MARK = '<roadMark sOffset="0" type="{}" material="standard" color="white" width="0.15"/>'


def lane(number: int, kind: str, width_m: float, mark: str) -> str:
    return (
        f'<lane id="{number}" type="{kind}" level="false"><link/>{WIDTH.format(width_m)}'
        f"{MARK.format(mark)}</lane>"
    )


def side(sign: int) -> str:
    lanes = [
        lane(sign, "driving", 3.5, "broken"),
        lane(2 * sign, "driving", 3.5, "solid"),
        lane(3 * sign, "shoulder", 0.5, "curb"),
        lane(4 * sign, "sidewalk", 3.0, "none"),
    ]
    return "".join(lanes if sign < 0 else lanes[::-1])


STREET = (
    f'<left>{side(1)}</left><center><lane id="0" type="none"/></center><right>{side(-1)}</right>'
)
THROUGH = (
    '<center><lane id="0" type="none"/></center>'
    f"<right>{lane(-1, 'driving', 3.5, 'none')}{lane(-2, 'driving', 3.5, 'none')}</right>"
)


def road(
    name: str,
    junction: str,
    pose: tuple[float, float, float],
    bend: float,
    length: float,
    link: str,
) -> str:
    shape = f'<arc curvature="{bend:.17g}"/>' if bend else "<line/>"
    lanes = STREET if junction == "-1" else THROUGH
    x, y, yaw = pose
    return (
        f'<road name="" id="{name}" length="{length:.17g}" junction="{junction}">'
        f'<link>{link}</link><type s="0" type="town"><speed max="50" unit="km/h"/></type><planView>'
        f'<geometry s="0" x="{x:.17g}" y="{y:.17g}" hdg="{yaw:.17g}" length="{length:.17g}">{shape}'
        f'</geometry></planView><elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/>'
        '</elevationProfile><lanes><laneOffset s="0" a="0" b="0" c="0" d="0"/>'
        f'<laneSection s="0">{lanes}</laneSection></lanes></road>\n'
    )


def link(tag: str, kind: str, name: str, contact: str = "") -> str:
    end = f' contactPoint="{contact}"' if contact else ""
    return f'<{tag} elementType="{kind}" elementId="{name}"{end}/>'


def arms(i: int, j: int) -> dict[int, tuple[str, str]]:
    """Streets at a junction by quarter turn (0 east): their id, and which end is here."""
    found = {}
    if i + 1 < SIDE:
        found[0] = (f"h{i}_{j}", "start")
    if j + 1 < SIDE:
        found[1] = (f"v{i}_{j}", "start")
    if i > 0:
        found[2] = (f"h{i - 1}_{j}", "end")
    if j > 0:
        found[3] = (f"v{i}_{j - 1}", "end")
    return found


def streets() -> Iterator[str]:
    length = BLOCK_M - 2 * HALF_M
    for i in range(SIDE):
        for j in range(SIDE):
            for name, (di, dj), yaw in (("h", (1, 0), 0.0), ("v", (0, 1), math.pi / 2)):
                if i + di < SIDE and j + dj < SIDE:
                    x, y = i * BLOCK_M + di * HALF_M, j * BLOCK_M + dj * HALF_M
                    ends = link("predecessor", "junction", f"j{i}_{j}")
                    ends += link("successor", "junction", f"j{i + di}_{j + dj}")
                    yield road(f"{name}{i}_{j}", "-1", (x, y, yaw), 0.0, length, ends)


def junctions() -> Iterator[str]:
    """Straight on, and turns to both sides, from every arm to every other one."""
    for i in range(SIDE):
        for j in range(SIDE):
            here = arms(i, j)
            connections: list[str] = []
            for a, (street, end) in here.items():
                for b, (goal, contact) in here.items():
                    turn = (b - a - 2 + 1) % 4 - 1  # quarter turns to the left
                    if a == b:
                        continue
                    name = f"c{i}_{j}_{a}{b}"
                    inward = math.pi / 2 * a + math.pi
                    x = i * BLOCK_M + HALF_M * math.cos(math.pi / 2 * a)
                    y = j * BLOCK_M + HALF_M * math.sin(math.pi / 2 * a)
                    length = 2 * HALF_M if turn == 0 else math.pi / 2 * HALF_M
                    ends = link("predecessor", "road", street, end)
                    ends += link("successor", "road", goal, contact)
                    bend = turn / HALF_M
                    yield road(name, f"j{i}_{j}", (x, y, inward), bend, length, ends)
                    connections.append(
                        f'<connection id="{len(connections)}" incomingRoad="{street}" '
                        f'connectingRoad="{name}" contactPoint="start"/>'
                    )
            yield f'<junction name="" id="j{i}_{j}">{"".join(connections)}</junction>\n'


def make_city(path: Path) -> None:
    with path.open("w") as stream:
        stream.write('<?xml version="1.0"?>\n<OpenDRIVE><header revMajor="1" revMinor="7"/>\n')
        stream.writelines(streets())
        stream.writelines(junctions())
        stream.write("</OpenDRIVE>\n")


def measure(what: str, path: Path) -> None:
    """Prints seconds of processor time, additional peak MiB and a note of one reading."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    note = ""
    if what == "ours":
        library = load_library(path)
        note = f"{len(library.blocks)} blocks"
    else:
        tree = safe_xml.parse(path)
        note = f"{len(tree.findall('road') + tree.findall('edge'))} roads"
    seconds = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps([seconds, max(0.1, (peak - before) / 1024), note]))


def child(what: str, path: Path) -> tuple[float, float, str]:
    done = subprocess.run(
        [sys.executable, __file__, "--measure", what, str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, peak_mib, note = json.loads(done.stdout)
    return seconds, peak_mib, note


def compare(path: Path) -> None:
    ours, bare = [], []
    for _ in range(ROUNDS):
        bare.append(child("bare", path))
        ours.append(child("ours", path))
    size = f"{path.stat().st_size / 2**20:.1f} MiB, {bare[0][2]}, {ours[0][2]}, best of {ROUNDS}"
    for i, (name, unit) in enumerate((("time", "s"), ("peak memory", "MiB"))):
        report(
            f"topology: {name}",
            float(min(run[i] for run in ours)),
            float(min(run[i] for run in bare)),
            unit,
            size,
            lower=True,
        )


def main() -> None:
    if sys.argv[1:2] == ["--measure"]:
        measure(sys.argv[2], Path(sys.argv[3]))
    elif len(sys.argv) > 1:
        compare(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "city.xodr"
            make_city(path)
            compare(path)


if __name__ == "__main__":
    main()
