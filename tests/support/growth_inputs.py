"""Inputs of any size for measuring how commands grow."""

from __future__ import annotations

import math
import random

_LANES = (
    '<laneSection s="0"><left>{left}</left><center><lane id="0" type="none"/></center>'
    "<right>{right}</right></laneSection>"
)
_LANE = '<lane id="{id}" type="{type}"><width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'


def fine_road(pieces: int, step_m: float = 0.5) -> str:
    """An OpenDRIVE road of two lanes each way with sidewalks, in arcs of half a metre.

    Args:
        step_m: length of a piece.
    """
    x = y = heading = 0.0
    geometry = []
    for i in range(pieces):
        k = 0.0005 * math.sin(i / 400.0) or 1e-9
        geometry.append(
            f'<geometry s="{i * step_m}" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{step_m}">'
            f'<arc curvature="{k!r}"/></geometry>'
        )
        after = heading + k * step_m
        x += (math.sin(after) - math.sin(heading)) / k
        y -= (math.cos(after) - math.cos(heading)) / k
        heading = after

    outward = [("driving", 3.5), ("driving", 3.5), ("sidewalk", 3.0)]
    sides = [
        [
            _LANE.format(id=sign * n, type=kind, width=width)
            for n, (kind, width) in enumerate(outward, 1)
        ]
        for sign in (1, -1)
    ]
    lanes = _LANES.format(left="".join(reversed(sides[0])), right="".join(sides[1]))
    return (
        '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="7"/>'
        f'<road id="1" length="{pieces * step_m}" junction="-1"><type s="0" type="town">'
        f'<speed max="15"/></type><planView>{"".join(geometry)}</planView><lanes>{lanes}</lanes>'
        "</road></OpenDRIVE>"
    )


def cells_csv(rows: int) -> str:
    """Component scores of ten models in three domains, over as many scenarios as it takes."""
    some = random.Random(1)
    lines = ["scenario,domain,model,jovr,sem_acc_eff,cia_eff,act_acc_eff,tqsr,atc_eff,risk"]
    for model in range(10):
        for domain in ("synthetic", "simulation", "physical"):
            for scenario in range(max(1, rows // 30)):
                scores = ",".join(f"{some.random():.3f}" for _ in range(6))
                lines.append(f"s{scenario},{domain},model{model},{scores},F")
    return "\n".join(lines) + "\n"
