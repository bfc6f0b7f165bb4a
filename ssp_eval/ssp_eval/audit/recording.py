"""Reads from a bag, and from beside it, all that an audit looks at."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.bag import BagReader, object_states
from ssp_core.camera import Intrinsics
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping
from ssp_core.messages import object_state, peek_stamp_ns, stamp_ns
from ssp_core.names import (
    CAMERA_IMAGE,
    PHASE_EVENT,
    SAFETY_EVENT,
    WORLD_TICK,
    absolute,
)
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, Phase
from ssp_eval.audit.changes import Attached, read_attached
from ssp_eval.audit.coverage import Moment, Optics
from ssp_eval.audit.identity import WORLD, Sighting
from ssp_eval.evaluate.campaign import find_labels
from ssp_eval.evaluate.clip import Clip
from ssp_eval.evaluate.provenance import IMPORT_ATTACHMENT, Provenance, read_provenance
from ssp_eval.labels.model import Labels, load_labels

_IMAGE = absolute(CAMERA_IMAGE)
_TICK = absolute(WORLD_TICK)
_STATE_AGE_S = 0.3

States = Mapping[str, ObjectState]


@dataclass(frozen=True)
class SafetyRecord:
    """A recorded safety event: clip time, number and words."""

    t_s: float
    code: int
    text: str


@dataclass(frozen=True)
class Recording:
    """One recording, read.

    Args:
        path: of the bag.
        provenance: what the bag says of itself.
        start_s: clip time of the clip's start, None: it never began.
        end_s: clip time of its last frame, or of its last state where there are no frames.
        frames_s: clip times of the frames from start to end.
        series: (clip time, states by id) from start to end; empty for an imported video.
        source: where the states come from, for people.
        sightings: every recorded state from the start on, for identities.
        tracking_m: per OT the largest longitudinal and lateral tracking error that it reported.
        phase_events: clip times of the phases as they were recorded during the run.
        safety: safety events.
        optics: None: the camera isn't known.
        attached: task, K*, site and log.
        imported: content of import.json, None for a session.
        labels: beside the bag of an imported video, None where there are none; a session's aren't
            read, since its states say more.
        labels_file: their file.
    """

    path: Path
    provenance: Provenance
    start_s: float | None
    end_s: float | None
    frames_s: tuple[float, ...]
    series: Sequence[tuple[float, States]]
    source: str
    sightings: tuple[Sighting, ...]
    tracking_m: Mapping[str, tuple[float, float]]
    phase_events: Mapping[str, float]
    safety: tuple[SafetyRecord, ...]
    optics: Optics | None
    attached: Attached
    imported: Mapping[str, Any] | None
    labels: Labels | None
    labels_file: Path | None

    def moments(self) -> list[Moment]:
        """The states at each frame, extrapolated from the newest ones."""
        times = [t_s for t_s, _ in self.series]
        found = []
        for t_s in self.frames_s:
            i = bisect_right(times, t_s + 1e-9) - 1
            if i < 0 or t_s - times[i] > _STATE_AGE_S:
                found.append(Moment(t_s, {}))
                continue
            ahead_ns = seconds_to_ns(t_s - times[i])
            found.append(
                Moment(
                    t_s,
                    {
                        key: state.extrapolated(state.stamp_ns + ahead_ns)
                        for key, state in self.series[i][1].items()
                    },
                )
            )
        return found


def find_bag(path: Path) -> Path:
    """The bag that somebody named: itself, or ``bag/`` in a run folder.

    Raises:
        InputError: it is neither.
    """
    if (path / "metadata.yaml").is_file() or path.suffix == ".mcap":
        return path
    if (path / "bag" / "metadata.yaml").is_file():
        return path / "bag"
    raise InputError(
        "is neither a bag nor a folder with one in bag/",
        file=path,
        remedy="give the folder of `ssp run` or of `ssp import-video`",
    )


def read_recording(path: str | Path) -> Recording:
    """Reads a recording.

    Args:
        path: bag directory, or a run folder that holds ``bag/``.

    Raises:
        InputError: it is no recording of this project, or is damaged.
    """
    bag_path = find_bag(Path(path))
    with BagReader(bag_path) as bag:
        provenance = read_provenance(bag)
        attached = read_attached(bag)
        imported = None
        if provenance.run is None:
            place = f"{bag_path}:{IMPORT_ATTACHMENT}"
            imported = parse_mapping(bag.attachment(IMPORT_ATTACHMENT) or b"{}", place)
        frames_ns = sorted(peek_stamp_ns(m.data) for m in bag.messages([_IMAGE]))
        start_ns = provenance.session_start_ns
        if start_ns is None and provenance.run is None and frames_ns:
            start_ns = frames_ns[0]
        states = _States(bag, provenance, start_ns)
        phase_events = _phase_events(bag, start_ns)
        safety = _safety_events(bag, start_ns)
    frames = [ns_to_seconds(ns - start_ns) for ns in frames_ns] if start_ns is not None else []
    first_s = last_s = None
    if start_ns is not None:
        ends = frames or [t_s for t_s, _ in states.series]
        first_s = max(0.0, ends[0]) if ends else None
        last_s = ends[-1] if ends else None
    inside = [
        t for t in frames if first_s is not None and last_s is not None and first_s <= t <= last_s
    ]
    labels_file = find_labels(bag_path) if provenance.run is None else None
    return Recording(
        path=bag_path,
        provenance=provenance,
        start_s=first_s,
        end_s=last_s,
        frames_s=tuple(inside),
        series=[
            (t, s)
            for t, s in states.series
            if first_s is not None and last_s is not None and first_s <= t <= last_s
        ],
        source=states.source,
        sightings=tuple(states.sightings),
        tracking_m=states.tracking_m,
        phase_events=phase_events,
        safety=tuple(safety),
        optics=_optics(bag_path) if frames_ns else None,
        attached=attached,
        imported=imported,
        labels=None if labels_file is None else load_labels(labels_file),
        labels_file=labels_file,
    )


class _States:
    """States of a session: the world's own where there is one, else what the objects reported."""

    def __init__(self, bag: BagReader, provenance: Provenance, start_ns: int | None) -> None:
        self.series: list[tuple[float, States]] = []
        self.sightings: list[Sighting] = []
        self.tracking_m: dict[str, tuple[float, float]] = {}
        self.source = "no states"
        run = provenance.run
        if run is None or start_ns is None:
            return
        self._start_ns = start_ns
        for message in bag.messages([_TICK]):
            tick = bag.decode(message)
            t_s = ns_to_seconds(stamp_ns(tick.header.stamp) - start_ns)
            if tick.running and t_s >= 0.0:
                objects = [object_state(o) for o in tick.objects]
                self.series.append((t_s, {o.object_id: o for o in objects}))
                self.sightings += [_sighting(t_s, WORLD, o, 0) for o in objects]
        ids = [run.vut.id, *(target.id for target in run.targets)]
        reported = {
            name: self._own_states(name, states) for name, states in object_states(bag, ids).items()
        }
        if self.series:
            self.source = f"ground truth ({WORLD_TICK})"
        else:
            self.series = _joined(reported, run.vut.id)
            self.source = "states that the objects reported"

    def _own_states(
        self, name: str, states: Sequence[ObjectState]
    ) -> list[tuple[float, ObjectState]]:
        found = []
        for state in states:
            t_s = ns_to_seconds(state.stamp_ns - self._start_ns)
            # Before the start states repeat; afterwards objects are switched off one by one.
            if t_s > 0.0 and state.control_state is not ControlState.OFF:
                found.append((t_s, state))
                self.sightings.append(_sighting(t_s, name, state, state.sequence))
                if state.reference_id:
                    along, aside = self.tracking_m.get(name, (0.0, 0.0))
                    self.tracking_m[name] = (
                        max(along, abs(state.error_longitudinal_m)),
                        max(aside, abs(state.error_lateral_m)),
                    )
        return found


def _sighting(t_s: float, source: str, state: ObjectState, sequence: int) -> Sighting:
    return Sighting(
        t_s, source, state.object_id, state.object_class.word, state.x_m, state.y_m,
        state.speed_mps, sequence,
    )  # fmt: skip


def _joined(
    reported: Mapping[str, Sequence[tuple[float, ObjectState]]], vut_id: str
) -> list[tuple[float, States]]:
    """States of all objects at the stamps of the VUT's, the others extrapolated to them."""
    ordered = {
        name: sorted(((t, s) for t, s in states if s.object_id == name), key=lambda x: x[0])
        for name, states in reported.items()
    }
    times = {name: [t for t, _ in states] for name, states in ordered.items()}
    series: list[tuple[float, States]] = []
    for t_s, vut in ordered.get(vut_id, []):
        now: dict[str, ObjectState] = {vut_id: vut}
        for name, states in ordered.items():
            i = bisect_right(times[name], t_s) - 1
            if name != vut_id and i >= 0 and t_s - times[name][i] <= _STATE_AGE_S:
                now[name] = states[i][1].extrapolated(vut.stamp_ns)
        if not series or t_s > series[-1][0]:
            series.append((t_s, now))
    return series


def _phase_events(bag: BagReader, start_ns: int | None) -> dict[str, float]:
    found: dict[str, float] = {}
    if start_ns is None:
        return found
    for message in bag.messages([absolute(PHASE_EVENT)]):
        event = bag.decode(message)
        word = Phase(event.phase).name.lower()
        found.setdefault(word, ns_to_seconds(stamp_ns(event.header.stamp) - start_ns))
    return found


def _safety_events(bag: BagReader, start_ns: int | None) -> list[SafetyRecord]:
    found = []
    for message in bag.messages([absolute(SAFETY_EVENT)]):
        event = bag.decode(message)
        t_s = ns_to_seconds(stamp_ns(event.header.stamp) - (start_ns or 0))
        who = f" of {event.object_id}" if event.object_id else ""
        meaning = MEANINGS.get(SafetyCode(event.code)) if event.code in set(SafetyCode) else None
        words = meaning.text if meaning is not None else "a limit was passed"
        found.append(
            SafetyRecord(
                t_s,
                int(event.code),
                f"{event.limit_name}{who} at {t_s:.2f} s: {event.measured:.3g} against "
                f"{event.limit:.3g} {event.unit}".rstrip()
                + f" ({words})",
            )
        )
    return found


def _optics(path: Path) -> Optics | None:
    with Clip(path) as clip:
        camera, mount = clip.camera, clip.mount
    if camera is None or mount is None:
        return None
    lens = Intrinsics(
        camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    )
    return Optics(lens, mount)
