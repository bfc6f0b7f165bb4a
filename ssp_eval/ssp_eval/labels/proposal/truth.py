"""Ground truth of a recording for label proposals, whoever recorded it (METHOD 4.3).

Only label proposals read it. No request is ever built from it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.labels.proposal.basis import Truth
from ssp_eval.labels.proposal.k_star import (
    UNKNOWN_VERSION,
    EventRules,
    KStar,
    attached_event,
    rules_of,
)
from ssp_eval.labels.proposal.truth_file import truth_from_file
from ssp_eval.recordings.provenance import Provenance, read_provenance
from ssp_eval.recordings.states import frame_times, read_states


def truth_from_bag(
    path: str | Path,
    given: KStar | None = None,
    truth_file: Path | None = None,
    version: str | None = None,
) -> Truth:
    """Ground truth of a recording, in clip time: simulated, live, or another's with states.

    Args:
        path: of the bag.
        given: the K*, where the bag holds none.
        truth_file: that its clip's maker wrote, for a bag of a video without states.
        version: K* version, where the recording names none.

    Raises:
        InputError: it is no recording, never ran, holds no states or frames, or realises another
            K* than the one that is given.
    """
    with BagReader(path) as bag:
        provenance = read_provenance(bag)
        k_star = attached_event(bag) or given
        frames_s, zero_ns = frame_times(bag, provenance)
        states = read_states(bag, provenance, zero_ns)
    version = _version(path, provenance, given, version)
    rules = rules_of(k_star, provenance, provenance.scenario, version)
    if truth_file is not None:
        return _of_clip(path, provenance, rules, frames_s, truth_file, version)
    who = provenance.participants
    start_s, end_s = max(0.0, frames_s[0]), frames_s[-1]
    series = [
        (t_s, list(now.values())) for t_s, now in states.series if start_s <= t_s <= end_s
    ]  # fmt: skip
    if who is None or not series:
        raise InputError(
            "holds no states",
            file=path,
            remedy="give the clip's own --truth file, or write labels by hand (--template)",
        )
    return Truth(
        scenario=_scenario(path, provenance, k_star),
        domain=provenance.domain,
        event_version=version,
        start_s=start_s,
        end_s=end_s,
        vut_id=who.vut,
        target_ids=tuple(who.targets),
        series=series,
        source=str(path),
        hfov_rad=_hfov_rad(provenance),
        thresholds=rules.thresholds or ConflictThresholds(),
        observable=rules.observable,
        rules_of=rules.said_by,
        frames_s=frames_s,
        window=rules.window,
    )


def _of_clip(
    path: str | Path,
    provenance: Provenance,
    rules: EventRules,
    frames_s: tuple[float, ...],
    truth_file: Path,
    version: str,
) -> Truth:
    """A video's frames with the states of its truth file, on the video's clock."""
    found = truth_from_file(truth_file, provenance.domain, version)
    crop = None if provenance.imported is None else provenance.imported.crop.get("start_s")
    shift_s = float(crop) if isinstance(crop, int | float) else 0.0
    start_s, end_s = max(0.0, frames_s[0]), frames_s[-1]
    series = [
        (t_s - shift_s, states) for t_s, states in found.series if start_s <= t_s - shift_s <= end_s
    ]
    if not series:
        raise InputError(
            f"has no states within the clip, {start_s:.2f} to {end_s:.2f} s",
            file=truth_file,
            remedy=f"it must be of the video in {path}",
        )
    return replace(
        found,
        scenario=provenance.scenario or found.scenario,
        event_version=version,
        start_s=start_s,
        end_s=end_s,
        series=series,
        thresholds=rules.thresholds or found.thresholds,
        observable=rules.observable or found.observable,
        rules_of=rules.said_by,
        frames_s=frames_s,
        window=rules.window or found.window,
    )


def _version(
    path: str | Path, provenance: Provenance, given: KStar | None, named: str | None
) -> str:
    told = provenance.event_version
    for other in (None if given is None else given.version, named):
        if told is not None and other not in (None, told):
            raise InputError(
                f"realises K* {told}, given is {other}",
                file=path,
                remedy="give the K* that the recording was made from",
            )
    return told or named or (None if given is None else given.version) or UNKNOWN_VERSION


def _scenario(path: str | Path, provenance: Provenance, k_star: KStar | None) -> str:
    found = provenance.scenario or (None if k_star is None else k_star.event.name)
    if found is None:
        raise InputError(
            "doesn't say which scenario it shows", file=path, remedy="give its K* with --event"
        )
    return found


def _hfov_rad(provenance: Provenance) -> float | None:
    """Of the forward camera; None: nobody knows it."""
    run, imported = provenance.run, provenance.imported
    if run is not None:
        return None if run.camera is None else math.radians(run.camera.hfov_deg)
    hfov_deg = None if imported is None else imported.camera.hfov_deg
    return None if hfov_deg is None else math.radians(hfov_deg)
