"""What a proposal of labels is made from: the ground truth of a clip, and rules."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from ssp_core.motion.encounter import Observable
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.recordings.crop import Window
from ssp_eval.recordings.geometry import DEFAULT_MOTION, MotionThresholds


@dataclass(frozen=True)
class ProposalRules:
    """Everything that a proposal depends on besides the states.

    Args:
        count: labels on a clock grid, at least one.
        spacing_s: between labels on a clock grid.
        hfov_rad: the camera's horizontal field of view where the clip doesn't know it.
        range_m: beyond it an object doesn't count as visible.
        motion: thresholds of the motion classes.
    """

    count: int = 9
    spacing_s: float = 0.5
    hfov_rad: float = math.radians(75.0)
    range_m: float = 80.0
    motion: MotionThresholds = DEFAULT_MOTION


@dataclass(frozen=True)
class Truth:
    """Ground truth of one clip.

    Args:
        scenario: name.
        domain: of METHOD 5.2.
        event_version: K* version.
        start_s: clip time from which labels are possible (the first frame).
        end_s: clip time of the last frame.
        vut_id: object id of the VUT.
        target_ids: the OTs.
        series: (clip time in s, states of all objects), times rising.
        source: the file, for messages.
        hfov_rad: of the forward camera, None: not known.
        thresholds: the event's own, where its K* or its run gives them.
        observable: what makes the manoeuvre observable, None: not known.
        rules_of: whose thresholds and observable these are, for people.
        frames_s: clip times of the frames, rising.
        window: of the source's crop (METHOD 4.1), None: nobody knows it.
    """

    scenario: str
    domain: str
    event_version: str
    start_s: float
    end_s: float
    vut_id: str
    target_ids: tuple[str, ...]
    series: Sequence[tuple[float, Sequence[ObjectState]]]
    source: str
    hfov_rad: float | None = None
    thresholds: ConflictThresholds = field(default_factory=ConflictThresholds)
    observable: Observable | None = None
    rules_of: str = "no K*, the defaults"
    frames_s: Sequence[float] = ()
    window: Window | None = None


DEFAULT_RULES = ProposalRules()
