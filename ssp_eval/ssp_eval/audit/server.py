"""The CARLA server that drew or moved a recording: disclosed, and held against its probe."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import astuple

from ssp_core.carla.address import CarlaAddress, parse_address
from ssp_core.carla.probe_report import Outcome
from ssp_core.carla.record import CarlaPlantRecord, CarlaScene
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.data.provenance import CARLA, Provenance
from ssp_eval.data.server import PROBE_FILE, ServerProbe

CODE = "server_unproven"
# Checks without which a file shows nothing of a server.
_NEEDED = ("teleport", "frames", "box_in_picture")
# A body that was measured twice has one box.
_SAME_BOX_M = 0.01


def server_findings(facts: Provenance) -> Iterator[Finding]:
    """Find why nothing shows that pictures are those of a recording's states, or who moved it."""
    run = facts.run
    moved = run is not None and run.plant == "carla"
    yield from _of_server(facts.scene, "drew", facts.renderer == CARLA, facts)
    yield from _of_server(facts.plant, "moved", moved, facts)


def _of_server(
    record: CarlaScene | CarlaPlantRecord | None,
    did: str,
    is_required: bool,
    facts: Provenance,
) -> Iterator[Finding]:
    if record is None:
        if is_required:
            yield Finding(CODE, f"the bag holds no record of the server that {did} it")
        return
    if record.counterpart:
        text = f"a stand-in for CARLA in tests {did} it, which is no evidence of anything"
        yield Finding(CODE, text)
        return
    if facts.probe is None:
        text = (
            f"no {PROBE_FILE} lies beside the bag: `ssp carla probe` of the server that {did} it "
            "makes one"
        )
        yield Finding(CODE, text)
        return
    for text in _contradictions(record, facts.probe):
        yield Finding(CODE, text)


def _contradictions(record: CarlaScene | CarlaPlantRecord, probe: ServerProbe) -> Iterator[str]:
    report = probe.report
    rows = {row.check: row for row in report.rows}
    failed = [name for name, row in rows.items() if row.outcome is Outcome.FAIL]
    if failed:
        yield f"the server failed its probe: {', '.join(failed)}"
    if missing := [name for name in _NEEDED if name not in rows]:
        yield f"{PROBE_FILE} lacks {', '.join(missing)}"
    if report.version != record.version:
        yield f"{PROBE_FILE} is of CARLA {report.version}, the server was {record.version}"
    if _is_another(record.address, probe):
        yield f"{PROBE_FILE} is of {_probed(probe)}, the server was {record.address}"
    boxes = {body.blueprint: body.box for body in report.bodies}
    for name, body in sorted(record.bodies.items()):
        box = boxes.get(body.blueprint)
        if box is None:
            yield f"{PROBE_FILE} has no box of {body.blueprint}, the body of {name}"
        elif any(
            not math.isclose(a, b, abs_tol=_SAME_BOX_M)
            for a, b in zip(astuple(box), astuple(body.measured), strict=True)
        ):
            yield f"{PROBE_FILE} has another box of {body.blueprint}, the body of {name}"


def _probed(probe: ServerProbe) -> CarlaAddress:
    return CarlaAddress(probe.report.host, probe.report.port)


def _is_another(address: str, probe: ServerProbe) -> bool:
    """Tell whether a probe is of another port of the same host; hosts may have several names."""
    if not address:
        return False
    used, probed = parse_address(address, "address"), _probed(probe)
    return used.host == probed.host and used.port != probed.port


def server_disclosures(facts: Provenance) -> dict[str, str]:
    """Describe the server, its camera and weather, its probe, and each participant's body."""
    texts = {}
    if (scene := facts.scene) is not None:
        texts["CARLA"] = f"{_server(scene)}, seed {scene.seed}"
        texts["weather of CARLA"] = _listed(scene.weather)
        texts["triggers with CARLA"] = scene.trigger_text
        texts["camera of CARLA"] = _listed(scene.camera)
        texts["scenery of CARLA"] = _scenery_text(facts)
    if (plant := facts.plant) is not None:
        texts["plant"] = f"vehicle physics of CARLA {_server(plant)}; no two such runs are equal"
    if scene is not None or plant is not None:
        texts["probe of CARLA"] = "none" if facts.probe is None else _probe_text(facts, facts.probe)
    return texts | facts.carla_texts


def _scenery_text(facts: Provenance) -> str:
    """Say what stands beside the road in the run, and not in CARLA's pictures."""
    road = None if facts.run is None else facts.run.road
    kinds = Counter(item.type.replace("_", " ") for item in ([] if road is None else road.scenery))
    if not kinds:
        return "its map's own"
    lacking = ", ".join(f"{count} × {kind}" for kind, count in sorted(kinds.items()))
    return f"its map's own; of the run's road it has no actors for {lacking}"


def _server(record: CarlaScene | CarlaPlantRecord) -> str:
    step = "synchronous" if record.synchronous else "not synchronous"
    at = f" at {record.address}" if record.address else ""
    return (
        f"{record.version}{at}, map {record.map_name} ({record.map_sha256}), {step}, step "
        f"{record.step_s:g} s, first frame {record.first_frame}"
    )


def _probe_text(facts: Provenance, probe: ServerProbe) -> str:
    """Name a probe; where the server's host had another name there, that stands there too."""
    text = f"{PROBE_FILE} of {probe.report.started:%Y-%m-%d}, {probe.sha256}"
    used = {one.address for one in (facts.scene, facts.plant) if one is not None and one.address}
    if used - {str(_probed(probe))}:
        text += f", of {_probed(probe)}: only your word says that this is the same server"
    return text


def _listed(values: dict[str, float] | dict[str, str]) -> str:
    return ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in sorted(values.items())
    )
