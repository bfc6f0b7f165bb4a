"""The perfect control: reads the labels and answers them. Cheating, by design.

It shows that the chain from topic to score can reach 1 in every metric; it is privileged and is
no model. Its result belongs beside the models' as a check of the harness, never among them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, Strict

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError, PeerError
from ssp_core.files.reading import load_model
from ssp_core.vocabulary import (
    ConflictWord,
    LatWord,
    LonWord,
    MotionWord,
    ObjectWord,
    PositionWord,
)
from ssp_vla_bridge.backend import check_options
from ssp_vla_bridge.backends.phrases import (
    action_points,
    action_sentence,
    point_times,
    scene_text,
    waypoints,
)
from ssp_vla_bridge.messages import Answer, NativeArray, Request

MATCH_S = 0.11  # METHOD 6.1
# In the order of preference; a defensive action wherever the label allows one (METHOD 6.9).
_PREFERRED = ("decelerate", "stop", "maintain", "accelerate")
# Where the request doesn't tell the VUT's speed.
_UNKNOWN_MPS = 8.0


class PerfectLabel(BaseModel):
    """The part of a label (METHOD 5.2) that an answer needs; None is not evaluable."""

    model_config = ConfigDict(frozen=True)
    t_s: Annotated[float, Strict()]
    objects: tuple[ObjectWord, ...] | None = None
    position: PositionWord | None = None
    motion: MotionWord | None = None
    conflict: ConflictWord | None = None
    lon_actions: Annotated[tuple[LonWord, ...], Field(min_length=1)]
    lat_actions: Annotated[tuple[LatWord, ...], Field(min_length=1)]


class _Labels(BaseModel):
    labels: Annotated[tuple[PerfectLabel, ...], Field(min_length=1)]


class Perfect:
    """Answers each request from the label nearest to its time.

    Args:
        clip_start_ns: stamp of clip time 0, ns.
    """

    model_id = "ssp/perfect/1 (privileged control: reads the labels)"

    def __init__(self, labels: tuple[PerfectLabel, ...], clip_start_ns: int) -> None:
        self._labels = labels
        self._clip_start_ns = clip_start_ns

    def answer(self, request: Request) -> Answer:
        """Return the labels' answer; raise PeerError if no label is near the request's time."""
        time_s = ns_to_seconds(request.stamp_ns - self._clip_start_ns)
        label = min(self._labels, key=lambda candidate: abs(candidate.t_s - time_s))
        if abs(label.t_s - time_s) > MATCH_S + 1e-9:
            raise PeerError(
                f"no label within {MATCH_S} s of clip time {time_s:.3f} s; the nearest stands at "
                f"{label.t_s:.3f} s (is clip_start_ns {self._clip_start_ns} right?)"
            )
        lon_action = next(action for action in _PREFERRED if action in label.lon_actions)
        lat_action = "straight" if "straight" in label.lat_actions else label.lat_actions[0]
        speed_mps = request.history[-1].speed_mps if request.ego_known else _UNKNOWN_MPS
        scene = scene_text(label.objects, label.position, label.motion, label.conflict)
        return Answer(
            f"{scene} {action_sentence(lon_action, lat_action)}".strip(),
            (_trajectory(request, speed_mps, lon_action, lat_action),),
            {"privileged": True, "label_t_s": label.t_s},
        )


def _trajectory(
    request: Request, speed_mps: float, lon_action: str, lat_action: str
) -> NativeArray:
    times_s = point_times(request.task)
    return waypoints(action_points(lon_action, lat_action, speed_mps, times_s), request.task)


def make(options: Mapping[str, Any]) -> Perfect:
    """Make a control for the options ``labels_file`` and ``clip_start_ns`` (default 0).

    Raises:
        InputError: the options or the labels file are wrong.
    """
    check_options("perfect", options, {"labels_file": str, "clip_start_ns": int})
    if "labels_file" not in options:
        raise InputError(
            "is missing", field="backend_options.labels_file", remedy="name the clip's labels file"
        )
    labels = load_model(_Labels, str(options["labels_file"])).labels
    return Perfect(labels, int(options.get("clip_start_ns", 0)))
