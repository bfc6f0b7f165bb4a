"""The perfect control: reads the labels and answers them. Cheating, by design.

It shows that the chain from topic to score can reach 1 in every metric; it is privileged and is
no model. Its result belongs beside the models' as a check of the harness, never among them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError, PeerError
from ssp_core.files import read_mapping
from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_vla_bridge.backend import check_options
from ssp_vla_bridge.backends.phrases import (
    action_sentence,
    point_times,
    scene_text,
    travelled_m,
    waypoints,
)
from ssp_vla_bridge.messages import Answer, NativeArray, Request

MATCH_S = 0.11  # METHOD 6.1
# In the order of preference; a defensive action wherever the label allows one (METHOD 6.9).
_PREFERRED = ("decelerate", "stop", "maintain", "accelerate")
# Speeds in which every action below is both feasible and recognised (METHOD 6.6).
_SLOWEST_MPS, _FASTEST_MPS = 3.0, 20.0
_ACCELERATION_MPS2 = {"decelerate": -1.5, "maintain": 0.0, "accelerate": 1.5, "stop": -6.0}
_STOP_FROM_MPS = 3.0
_SIDEWAYS_MPS = {"left": 0.8, "straight": 0.0, "right": -0.8}


@dataclass(frozen=True)
class PerfectLabel:
    """The part of a label (METHOD 5.2) that an answer needs; None is not evaluable."""

    t_s: float
    objects: tuple[str, ...] | None
    position: str | None
    motion: str | None
    conflict: str | None
    lon_actions: tuple[str, ...]
    lat_actions: tuple[str, ...]


class Perfect:
    """Answers each request from the label nearest to its time.

    Args:
        labels: those of the clip that is replayed.
        clip_start_ns: stamp of clip time 0, ns.
    """

    model_id = "ssp/perfect/1 (privileged control: reads the labels)"

    def __init__(self, labels: tuple[PerfectLabel, ...], clip_start_ns: int) -> None:
        self._labels = labels
        self._clip_start_ns = clip_start_ns

    def answer(self, request: Request) -> Answer:
        """Raises PeerError: no label is near the request's time."""
        time_s = ns_to_seconds(request.stamp_ns - self._clip_start_ns)
        label = min(self._labels, key=lambda candidate: abs(candidate.t_s - time_s))
        if abs(label.t_s - time_s) > MATCH_S + 1e-9:
            raise PeerError(
                f"no label within {MATCH_S} s of clip time {time_s:.3f} s; the nearest stands at "
                f"{label.t_s:.3f} s (is clip_start_ns {self._clip_start_ns} right?)"
            )
        lon_action = next(action for action in _PREFERRED if action in label.lon_actions)
        lat_action = "straight" if "straight" in label.lat_actions else label.lat_actions[0]
        speed_mps = request.history[-1].speed_mps if request.ego_known else 8.0
        scene = scene_text(label.objects, label.position, label.motion, label.conflict)
        return Answer(
            f"{scene} {action_sentence(lon_action, lat_action)}".strip(),
            (_trajectory(request, speed_mps, lon_action, lat_action),),
            {"privileged": True, "label_t_s": label.t_s},
        )


def _trajectory(
    request: Request, speed_mps: float, lon_action: str, lat_action: str
) -> NativeArray:
    speed = min(max(speed_mps, _SLOWEST_MPS), _FASTEST_MPS)
    if lon_action == "stop":
        speed = _STOP_FROM_MPS
    acceleration = _ACCELERATION_MPS2[lon_action]
    points = [
        (travelled_m(time_s, speed, acceleration), _SIDEWAYS_MPS[lat_action] * time_s)
        for time_s in point_times(request.task)
    ]
    return waypoints(points, request.task)


def make(options: Mapping[str, Any]) -> Perfect:
    """A control for the options ``labels_file`` and ``clip_start_ns`` (default 0).

    Raises:
        InputError: the options or the labels file are wrong.
    """
    check_options("perfect", options, {"labels_file": str, "clip_start_ns": int})
    if "labels_file" not in options:
        raise InputError(
            "is missing", field="backend_options.labels_file", remedy="name the clip's labels file"
        )
    path = str(options["labels_file"])
    labels = read_mapping(path).get("labels")
    if not isinstance(labels, list) or not labels:
        raise InputError("must be a list of labels", file=path, field="labels", value=labels)
    parsed = tuple(_label(value, path, f"labels[{i}]") for i, value in enumerate(labels))
    return Perfect(parsed, int(options.get("clip_start_ns", 0)))


def _label(value: Any, path: str, place: str) -> PerfectLabel:
    if not isinstance(value, dict):
        raise InputError("must be a mapping", file=path, field=place, value=value)
    time_s = value.get("t_s")
    if not isinstance(time_s, (int, float)) or isinstance(time_s, bool):
        raise InputError("must be a number", file=path, field=f"{place}.t_s", value=time_s)

    def words(key: str, allowed: Sequence[str]) -> tuple[str, ...] | None:
        given = value.get(key)
        if given is None:
            return None
        listed = given if isinstance(given, list) else [given]
        for word in listed:
            if word not in allowed:
                raise InputError(
                    "is not in the vocabulary", file=path, field=f"{place}.{key}", value=word
                )
        return tuple(listed)

    def one(key: str, allowed: Sequence[str]) -> str | None:
        found = words(key, allowed)
        return found[0] if found else None

    def actions(key: str, allowed: Sequence[str]) -> tuple[str, ...]:
        found = words(key, allowed)
        if not found:
            raise InputError("must name an action", file=path, field=f"{place}.{key}")
        return found

    return PerfectLabel(
        t_s=float(time_s),
        objects=words("objects", OBJECTS),
        position=one("position", POSITIONS),
        motion=one("motion", MOTIONS),
        conflict=one("conflict", CONFLICTS),
        lon_actions=actions("lon_actions", LON_ACTIONS),
        lat_actions=actions("lat_actions", LAT_ACTIONS),
    )
