"""Differences that are allowed and must be known (METHOD 4.4), measured or as they were set."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime

from ssp_eval.audit.changes import disclosed
from ssp_eval.audit.examined import Examined
from ssp_eval.recordings.provenance import Provenance
from ssp_scenario_manager.compile.compiler import LOGGED_AS
from ssp_scenario_manager.event_spec.log import Record

RENDERER = "renderer"
NO_RENDERER = "none is known"


def disclosures(one: Examined) -> dict[str, str]:
    """Renderer, local speed, tracking error, disturbance, camera, look; and what the log adds."""
    recording, run = one.recording, one.recording.provenance.run
    found: dict[str, str] = {RENDERER: recording.provenance.renderer or NO_RENDERER}
    if one.crop is not None and one.crop.shortfall:
        found["clip"] = f"{one.crop.shortfall}: the recording holds no more"
    found |= _local_speed(one)
    if run is None:
        return found | _of_import(recording.provenance)
    found["site"] = f"{run.site}, {run.mode}, seed {run.seed}"
    if run.stand_in:
        found["stand-in"] = "software stands in for vehicles on a track"
    for name, (along_m, aside_m) in recording.tracking_m.items():
        found[f"tracking error of {name}"] = (
            f"at most {along_m:.2f} m along and {aside_m:.2f} m beside its reference"
        )
    link = run.disturbance
    if link != type(link)():
        found["communication"] = (
            f"states {1000 * link.state_delay_s:.0f} ms late, {100 * link.state_loss:.1f} % lost, "
            f"noise {link.position_noise_m:g} m and {link.speed_noise_mps:g} m/s"
        )
        if not math.isclose(link.actuator_lag_scale, 1.0):
            found["actuators"] = f"lag times {link.actuator_lag_scale:g}"
    if run.camera is not None:
        camera = run.camera
        found["camera"] = (
            f"{camera.width_px} x {camera.height_px} px, {camera.hfov_deg:g} degrees, "
            f"{camera.rate_hz:g} Hz"
        )
    found["look"] = f"palette {run.look.palette}"
    attached = recording.attached
    return {
        **found,
        **disclosed(attached),
        **order_remark([*attached.records, *attached.later]),
    }


def shared_renderers(found: Sequence[Mapping[str, str]], domains: Sequence[str]) -> list[str]:
    """For each recording, which other domains were drawn by the same renderer; empty: none.

    Args:
        found: disclosures of each recording.
        domains: of each.
    """
    drawn = [one[RENDERER] for one in found]
    return [
        ", ".join(
            other
            for other, by in zip(domains, drawn, strict=True)
            if other != domain and by == mine and mine != NO_RENDERER
        )
        for domain, mine in zip(domains, drawn, strict=True)
    ]


def _of_import(facts: Provenance) -> dict[str, str]:
    imported = facts.imported
    found = {"source": facts.origin, "camera": f"{facts.camera}, ego motion {facts.ego}"}
    if imported is None:
        return found
    source = imported.source
    if "width_px" in source:
        found["picture"] = (
            f"{source['width_px']} x {source['height_px']} px at {source['fps']:g} Hz"
        )
    if imported.site is not None:
        found["site"] = f"{imported.site.name}, {imported.site.block}"
    if imported.states is not None and imported.states.notes:
        found["states"] = "; ".join(imported.states.notes)
    return found


def _local_speed(one: Examined) -> dict[str, str]:
    if one.measured is None:
        return {}
    facts = one.measured.facts
    speeds = [
        f"{who} {facts[key]:.1f} m/s"
        for who, key in (("VUT", "vut_speed_at_trigger_mps"), ("OT", "ot_speed_at_trigger_mps"))
        if facts.get(key) is not None
    ]
    return {"local speed": f"at the trigger {', '.join(speeds)}"} if speeds else {}


def order_remark(records: Iterable[Record]) -> dict[str, str]:
    """A remark on entries that are older by their own words than one that stands above them.

    A log is only appended to, so such a time was typed wrongly, or a clock was. The compiler's
    entries carry a fixed time (docs/log.md) and are not judged.

    Args:
        records: one log, in the order in which its entries were appended.

    Returns:
        Empty, or one text under ``times in the log``.
    """
    newest: Record | None = None
    found = []
    for number, record in enumerate(records, start=1):
        if newest is not None and _time(record) < _time(newest) and record.who != LOGGED_AS:
            found.append(
                f"entry {number} ({record.field or record.kind}, {record.who}) says "
                f"{record.when}, and one above it {newest.when}"
            )
        if newest is None or _time(record) > _time(newest):
            newest = record
    return {"times in the log": "; ".join(found)} if found else {}


def _time(record: Record) -> datetime:
    return datetime.fromisoformat(record.when)
