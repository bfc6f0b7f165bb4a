"""The CARLA server that drew a recording's pictures: disclosed, and held against its probe."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import astuple

from ssp_core.carla.probe_report import Outcome
from ssp_core.carla.record import CarlaScene
from ssp_eval.audit.reasons import Finding
from ssp_eval.data.provenance import CARLA, PROBE_FILE, Provenance, ServerProbe

CODE = "server_unproven"
# Checks without which a file shows nothing of a server.
_NEEDED = ("teleport", "frames", "box_in_picture")
# A body that was measured twice has one box.
_SAME_BOX_M = 0.01
# A counterpart of the server is for tests; none of its pictures is evidence of anything.
COUNTERPART_IS_ADMITTED = False


def server_findings(facts: Provenance) -> Iterator[Finding]:
    """Find why nothing shows that the pictures of a recording are those of its states."""
    scene = facts.scene
    if scene is None:
        if facts.renderer == CARLA:
            yield Finding(CODE, "the bag holds no record of the server that drew it")
        return
    if scene.counterpart:
        if not COUNTERPART_IS_ADMITTED:
            yield Finding(CODE, "drawn by a stand-in for CARLA in tests, which is no renderer")
        return
    if facts.probe is None:
        text = (
            f"no {PROBE_FILE} lies beside the bag: `ssp carla probe` of the server that drew it "
            "makes one"
        )
        yield Finding(CODE, text)
        return
    for text in _contradictions(scene, facts.probe):
        yield Finding(CODE, text)


def _contradictions(scene: CarlaScene, probe: ServerProbe) -> Iterator[str]:
    report = probe.report
    rows = {row.check: row for row in report.rows}
    failed = [name for name, row in rows.items() if row.outcome is Outcome.FAIL]
    if failed:
        yield f"the server failed its probe: {', '.join(failed)}"
    if missing := [name for name in _NEEDED if name not in rows]:
        yield f"{PROBE_FILE} lacks {', '.join(missing)}"
    if report.version != scene.version:
        yield f"{PROBE_FILE} is of CARLA {report.version}, the pictures are {scene.version}'s"
    boxes = {body.blueprint: body.box for body in report.bodies}
    for name, body in sorted(scene.bodies.items()):
        box = boxes.get(body.blueprint)
        if box is None:
            yield f"{PROBE_FILE} has no box of {body.blueprint}, the body of {name}"
        elif any(
            not math.isclose(a, b, abs_tol=_SAME_BOX_M)
            for a, b in zip(astuple(box), astuple(body.measured), strict=True)
        ):
            yield f"{PROBE_FILE} has another box of {body.blueprint}, the body of {name}"


def server_disclosures(facts: Provenance) -> dict[str, str]:
    """Describe the server, its camera and weather, its probe, and each participant's body."""
    scene = facts.scene
    if scene is None:
        return {}
    step = "synchronous" if scene.synchronous else "not synchronous"
    found = {
        "CARLA": f"{scene.version}, map {scene.map_name} ({scene.map_sha256}), {step}, step "
        f"{scene.step_s:g} s, first frame {scene.first_frame}, seed {scene.seed}",
        "weather of CARLA": _listed(scene.weather),
        "camera of CARLA": _listed(scene.camera),
        "probe of CARLA": "none"
        if facts.probe is None
        else f"{PROBE_FILE} of {facts.probe.report.started:%Y-%m-%d}, {facts.probe.sha256}",
    }
    for name, body in sorted(scene.bodies.items()):
        found[f"body of {name}"] = body.text
    return found


def _listed(values: dict[str, float] | dict[str, str]) -> str:
    return ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in sorted(values.items())
    )
