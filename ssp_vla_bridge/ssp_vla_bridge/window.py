"""The frames and the history that a request holds for each interface; the camera's geometry."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.geometry import wrap_angle
from ssp_core.hashing import sha256_json
from ssp_core.motion.state import ObjectState
from ssp_core.world.camera import Mounting
from ssp_vla_bridge.messages import CameraGeometry, EgoSample

# Recorders stamp in ns and cameras in their own clock: this much slack keeps a 10 Hz camera at
# 10 Hz.
_SLACK_NS = 1_000_000


@dataclass(frozen=True)
class Preprocessing:
    """The choice of frames and ego samples for a request.

    Args:
        frames: at most this many.
        frame_spacing_s: at least this far apart (0.1 s is 10 Hz).
        frame_span_s: no frame is older than the newest by this much.
        history_s: length of the ego history.
        history_spacing_s: between ego samples.
        state_age_s: an older newest state leaves the history empty.
    """

    frames: int = 10
    frame_spacing_s: float = 0.1
    frame_span_s: float = 1.0
    history_s: float = 2.0
    history_spacing_s: float = 0.1
    state_age_s: float = 0.3

    @property
    def sha256(self) -> str:
        return sha256_json(asdict(self))


def choose(stamps_ns: Sequence[int], newest: int, rules: Preprocessing) -> list[int]:
    """Return the indices of the frames that go into a request, rising; the last one is ``newest``.

    From the newest frame backwards, at most the given rate, number and span.

    Args:
        stamps_ns: of all frames, rising, ns.
        newest: index of the request's newest frame.
        rules: the rate, number and span of the frames.
    """
    spacing_ns = seconds_to_ns(rules.frame_spacing_s) - _SLACK_NS
    indices = [newest]
    oldest_ns = stamps_ns[newest] - seconds_to_ns(rules.frame_span_s) + _SLACK_NS
    i = newest - 1
    while i >= 0 and len(indices) < rules.frames and stamps_ns[i] >= oldest_ns:
        if stamps_ns[indices[-1]] - stamps_ns[i] >= spacing_ns:
            indices.append(i)
        i -= 1
    return indices[::-1]


def ego_history(
    stamps_ns: Sequence[int],
    state: Callable[[int], ObjectState],
    now_ns: int,
    rules: Preprocessing,
) -> tuple[EgoSample, ...]:
    """Return ego samples up to a time, oldest first; empty when no state is recent enough.

    Args:
        stamps_ns: of the VUT's states, rising, ns.
        state: the state of an index; asked for no more than is needed.
        now_ns: the request's time; no later state is looked at.
        rules: length and spacing of the history, and the greatest age of its newest state.
    """
    newest = bisect_right(stamps_ns, now_ns) - 1
    if newest < 0 or ns_to_seconds(now_ns - stamps_ns[newest]) > rules.state_age_s:
        return ()
    origin = state(newest).extrapolated(now_ns)
    samples = [_sample(origin, origin)]
    last_ns = now_ns
    for k in range(1, round(rules.history_s / rules.history_spacing_s) + 1):
        wanted_ns = now_ns - seconds_to_ns(k * rules.history_spacing_s)
        i = bisect_right(stamps_ns, wanted_ns) - 1
        if i < 0:
            break
        if stamps_ns[i] < last_ns:
            samples.append(_sample(state(i), origin))
            last_ns = stamps_ns[i]
    return tuple(reversed(samples))


def _sample(state: ObjectState, origin: ObjectState) -> EgoSample:
    x_m, y_m = origin.pose.to_local(state.x_m, state.y_m)
    return EgoSample(
        t_s=ns_to_seconds(state.stamp_ns - origin.stamp_ns),
        x_m=x_m,
        y_m=y_m,
        yaw_rad=wrap_angle(state.yaw_rad - origin.yaw_rad),
        speed_mps=state.speed_mps,
        yaw_rate_radps=state.yaw_rate_radps,
    )


@dataclass(frozen=True)
class Interface:
    """The inputs and outputs of a family of models.

    Args:
        adapter: that reads its answers, ``name`` or ``name:mode``.
        carries_previous: its request holds the model's own last answer about the same clip.
    """

    name: str
    adapter: str
    preprocessing: Preprocessing
    carries_previous: bool = False


_ALL = (
    Interface("waypoints", "waypoints", Preprocessing()),
    # One frame; ten steps of 0.5 s, which need eleven samples.
    Interface(
        "openemma",
        "openemma:corrected",
        Preprocessing(frames=1, history_s=5.0, history_spacing_s=0.5),
        carries_previous=True,
    ),
    # Six steps of 0.5 s, and the pose before for the first one's curvature.
    Interface(
        "lightemma",
        "lightemma",
        Preprocessing(frames=1, history_s=3.5, history_spacing_s=0.5),
    ),
    Interface(
        "llavida",
        "llavida",
        Preprocessing(frames=1, history_s=3.0, history_spacing_s=0.5),
    ),
    # Four frames and sixteen poses at 10 Hz, the last pose being the origin.
    Interface(
        "alpamayo",
        "alpamayo",
        Preprocessing(frames=4, frame_spacing_s=0.1, history_s=1.5, history_spacing_s=0.1),
    ),
)
INTERFACES: dict[str, Interface] = {one.name: one for one in _ALL}


def find_interface(name: str) -> Interface:
    """Return the interface of that name.

    Raises:
        InputError: there is none.
    """
    if name not in INTERFACES:
        raise InputError(
            "unknown interface",
            field="interface",
            value=name,
            remedy=f"known: {', '.join(sorted(INTERFACES))}",
        )
    return INTERFACES[name]


def mounting_of(transform: Any) -> Mounting:
    """Read a camera's mounting from a geometry_msgs/Transform."""
    move, turn = transform.translation, transform.rotation
    return Mounting.of_transform(
        (float(move.x), float(move.y), float(move.z)),
        (float(turn.x), float(turn.y), float(turn.z), float(turn.w)),
    )


def geometry_of(info: Any, mount: Mounting | None) -> CameraGeometry | None:
    """Return the geometry of a sensor_msgs/CameraInfo, None where its matrix K is unset.

    Args:
        info: a CameraInfo message.
        mount: None where the mounting isn't known.
    """
    if float(info.k[0]) <= 0.0 or float(info.k[4]) <= 0.0:
        return None
    return CameraGeometry(
        fx_px=float(info.k[0]),
        fy_px=float(info.k[4]),
        cx_px=float(info.k[2]),
        cy_px=float(info.k[5]),
        width_px=int(info.width),
        height_px=int(info.height),
        height_m=mount.height_m if mount is not None else None,
        pitch_down_rad=mount.pitch_down_rad if mount is not None else None,
    )
