"""The growth of processor time and peak memory of whole commands with the size of their input.

Each command runs in a process of its own at three sizes. The exponent is that of its processor time
between the two larger ones, without what the command takes for nothing. Above 1.2 the work grows
faster than its input, which a row of ``REASONS`` must explain.
"""

from __future__ import annotations

import importlib.util
import json
import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

sys.path.insert(0, str(Path(__file__).parents[2]))

from extraction import texts
from measure import LONG, cost, report

from tests.support.growth_inputs import cells_csv, fine_road

MOST = 1.2
# Path: the exponent that it may have, and why.
REASONS: dict[str, tuple[float, str]] = {}
# Less than this beyond the start of a command says nothing about its growth.
LEAST_S = 0.3
SECONDS = (60, 180, 540) if LONG else (30, 90, 270)
PIECES = (500, 1500, 4500)
ROWS = (300, 900, 2700)


@dataclass(frozen=True)
class Way:
    """A command at a size.

    Args:
        make: writes its input into a folder, and gives the arguments.
    """

    name: str
    unit: str
    sizes: tuple[int, int, int]
    make: Callable[[Path, int], list[str]]


def _recordings() -> ModuleType:
    """The builder of recordings that the tests of ssp_eval have."""
    place = Path(__file__).parents[2] / "ssp_eval" / "test" / "conftest.py"
    spec = importlib.util.spec_from_file_location("recording_builder", place)
    if spec is None or spec.loader is None:
        raise RuntimeError(f"{place} can't be loaded")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def write_recording(folder: Path, seconds: int, domain: str = "simulation") -> Path:
    """A VUT that drives all the time, and a car that cuts in 15 s before the end."""
    builder = _recordings()
    pictures = [builder.picture(k) for k in range(90)]
    builder.poses = lambda t_s: builder.k_star_poses(t_s - (seconds - 15.0))
    builder.picture = lambda k: pictures[k % 90]
    path = folder / domain
    return Path(
        builder.write_bag(
            path, domain=domain, duration_s=float(seconds), stand_in=domain == "physical"
        )
    )


def labels_new(folder: Path, seconds: int) -> list[str]:
    return ["labels", "new", str(write_recording(folder, seconds)), "--out", str(folder / "l")]


def audit(folder: Path, seconds: int) -> list[str]:
    bags = [
        str(write_recording(folder, seconds // 3, domain))
        for domain in ("synthetic", "simulation", "physical")
    ]
    return ["audit", *bags, "--out", str(folder / "audit")]


def bag_check(folder: Path, seconds: int) -> list[str]:
    return ["bag", "check", str(write_recording(folder, seconds))]


def compiled(folder: Path, pieces: int) -> list[str]:
    (folder / "fine.xodr").write_text(fine_road(pieces))
    return [
        *("compile", "vru_crossing", "--target", "sumo", "--map", str(folder / "fine.xodr")),
        *("--choose", "road 1 forward", "--who", "bench", "--out", str(folder / "task")),
    ]


def from_cells(folder: Path, rows: int) -> list[str]:
    (folder / "cells.csv").write_text(cells_csv(rows))
    return ["report", "--from-cells", str(folder / "cells.csv"), "--out", str(folder / "report")]


def extracted(folder: Path, count: int) -> list[str]:
    some = texts()
    lines = (json.dumps({"id": k, "text": some[k % len(some)]}) for k in range(count))
    (folder / "texts.jsonl").write_text("\n".join(lines) + "\n")
    return ["extract", str(folder / "texts.jsonl")]


WAYS = (
    Way("labels new", "s", SECONDS, labels_new),
    Way("audit", "s of three recordings", SECONDS, audit),
    Way("bag check", "s", SECONDS, bag_check),
    Way("compile", "pieces of 0.5 m", PIECES, compiled),
    Way("report --from-cells", "cells", ROWS, from_cells),
    Way("extract", "texts", ROWS, extracted),
)


def exponent(sizes: tuple[int, int, int], costs_s: list[float], start_s: float) -> float:
    """Compute the exponent of the growth between the two larger sizes; 0 where it costs next to
    nothing.
    """
    before, after = (cost_s - start_s for cost_s in costs_s[1:])
    if after < LEAST_S:
        return 0.0
    return math.log(after / max(before, LEAST_S / 3.0)) / math.log(sizes[2] / sizes[1])


def measure(way: Way) -> None:
    """One path at its three sizes."""
    found = []
    for size in way.sizes:
        with tempfile.TemporaryDirectory() as folder:
            found.append(cost(way.make(Path(folder), size)))
    start_s, _ = cost([*way.name.split(" --")[0].split(), "--help"])
    limit, why = REASONS.get(way.name, (MOST, ""))
    of_sizes = "/".join(map(str, way.sizes))
    costs = "/".join(f"{cpu_s:.2f}" for cpu_s, _ in found)
    peaks = "/".join(f"{peak_mb:.0f}" for _, peak_mb in found)
    report(
        f"growth: {way.name}, {of_sizes} {way.unit}: {costs} s, {peaks} MB",
        exponent(way.sizes, [cpu_s for cpu_s, _ in found], start_s),
        None,
        "exponent",
        f"processor time and peak memory of the command; {start_s:.2f} s for nothing{why}",
        lower=True,
        limit=limit,
    )


def main() -> None:
    for way in WAYS:
        measure(way)


if __name__ == "__main__":
    main()
