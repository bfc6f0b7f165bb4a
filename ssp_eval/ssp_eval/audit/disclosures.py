"""Differences that are allowed and must be known (METHOD 4), measured or as they were set."""

from __future__ import annotations

import math

from ssp_eval.audit.changes import disclosed
from ssp_eval.audit.examined import Examined
from ssp_eval.audit.log_order import order_remark


def disclosures(one: Examined) -> dict[str, str]:
    """Renderer, local speed, tracking error, disturbance, camera, look; and what the log adds."""
    recording, run = one.recording, one.recording.provenance.run
    found: dict[str, str] = {"renderer": recording.provenance.renderer or "none is known"}
    if run is None:
        imported = recording.provenance.imported
        found["source"] = recording.provenance.origin
        found["camera"] = f"{recording.provenance.camera}, ego motion {recording.provenance.ego}"
        source = {} if imported is None else imported.source
        if "width_px" in source:
            found["picture"] = (
                f"{source['width_px']} x {source['height_px']} px at {source['fps']:g} Hz"
            )
        return found
    found["site"] = f"{run.site}, {run.mode}, seed {run.seed}"
    if run.stand_in:
        found["stand-in"] = "software stands in for vehicles on a track"
    if one.measured is not None:
        facts = one.measured.facts
        speeds = [
            f"{who} {facts[key]:.1f} m/s"
            for who, key in (
                ("VUT", "vut_speed_at_trigger_mps"),
                ("OT", "ot_speed_at_trigger_mps"),
            )
            if facts.get(key) is not None
        ]
        if speeds:
            found["local speed"] = f"at the trigger {', '.join(speeds)}"
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
