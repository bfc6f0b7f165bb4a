"""Reads from a bag, and from beside it, all that an audit looks at."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ssp_core.bag.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns, stamp_ns
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.names import (
    CAMERA_IMAGE,
    PHASE_EVENT,
    SAFETY_EVENT,
    absolute,
)
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.vocabulary import Phase
from ssp_core.world.camera import Intrinsics
from ssp_eval.audit.changes import Attached, read_attached
from ssp_eval.audit.coverage import Moment, Optics
from ssp_eval.audit.measure import RoadFacts
from ssp_eval.evaluate.campaign import find_labels
from ssp_eval.evaluate.clip import Clip
from ssp_eval.labels.model import Labels, load_labels
from ssp_eval.recordings.agreement import Agreement, agree
from ssp_eval.recordings.crop import Crop
from ssp_eval.recordings.import_record import ImportedSite
from ssp_eval.recordings.observation_file import Footage, load_observations
from ssp_eval.recordings.provenance import Provenance, read_provenance
from ssp_eval.recordings.states import STATE_AGE_S, Series, Sighting, clip_zero_ns, read_states
from ssp_scenario_manager.event_spec.model import UNRESOLVED
from ssp_scenario_manager.maps.site import SiteBlock

_IMAGE = absolute(CAMERA_IMAGE)
_ROAD_WORDS = ("road_type", "left_boundary", "right_boundary")


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
        start_s: clip time of its beginning, None: it never began.
        end_s: clip time of its last frame, or of its last state where there are no frames.
        frames_s: clip times of the frames from start to end.
        series: (clip time, states by id) from start to end; empty where there are no states.
        source: where the states come from, for people.
        sightings: every recorded state from the start on, for identities.
        tracking_m: per OT the largest longitudinal and lateral tracking error that it reported.
        phase_events: clip times of the phases as the run announced them.
        safety: safety events.
        optics: None: the camera isn't known.
        attached: task, K*, site and log.
        labels: beside the bag, None where there are none; they are counted and decide nothing.
        agreement: what those who looked at it wrote down, sealed and bound to it; None: nobody did.
        observation_files: their files.
    """

    path: Path
    provenance: Provenance
    start_s: float | None
    end_s: float | None
    frames_s: tuple[float, ...]
    series: Series
    source: str
    sightings: tuple[Sighting, ...]
    tracking_m: Mapping[str, tuple[float, float]]
    phase_events: Mapping[str, float]
    safety: tuple[SafetyRecord, ...]
    optics: Optics | None
    attached: Attached
    labels: Labels | None
    agreement: Agreement | None = None
    observation_files: tuple[Path, ...] = ()

    @property
    def road(self) -> RoadFacts | None:
        """The road that is bound to the recording, with road type and boundaries where known."""
        road = self.provenance.road
        if road is None:
            return None
        imported = self.provenance.imported
        about: ImportedSite | SiteBlock | None = None if imported is None else imported.site
        if self.attached.site is not None and self.attached.task is not None:
            chosen = self.attached.task.block.id
            about = next((b for b in self.attached.site.blocks if b.id == chosen), None)
        if about is None:
            return RoadFacts(road)
        words = {name: str(getattr(about, name)) for name in _ROAD_WORDS}
        return RoadFacts(road, {name: word for name, word in words.items() if word != UNRESOLVED})

    def within(self, crop: Crop) -> Recording:
        """The recording as if it had been cut to its clip."""
        return replace(
            self,
            frames_s=tuple(t_s for t_s in self.frames_s if crop.holds(t_s)),
            series=[(t_s, states) for t_s, states in self.series if crop.holds(t_s)],
            sightings=tuple(s for s in self.sightings if crop.holds(s.t_s)),
        )

    def moments(self) -> list[Moment]:
        """The states at each frame, extrapolated from the newest ones."""
        times = [t_s for t_s, _ in self.series]
        found = []
        for t_s in self.frames_s:
            i = bisect_right(times, t_s + 1e-9) - 1
            if i < 0 or t_s - times[i] > STATE_AGE_S:
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
    """Reads a recording, and the observation files beside it.

    Args:
        path: bag directory, or a run folder that holds ``bag/``.

    Raises:
        InputError: it is no recording of this project, or is damaged; an observation file isn't
            of it, or was changed since it was sealed.
    """
    bag_path = find_bag(Path(path))
    with BagReader(bag_path) as bag:
        provenance = read_provenance(bag)
        attached = read_attached(bag)
        frames_ns = sorted(peek_stamp_ns(m.data) for m in bag.messages([_IMAGE]))
        start_ns = clip_zero_ns(provenance, frames_ns)
        states = read_states(bag, provenance, start_ns)
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
    labels_file = find_labels(bag_path)
    footage = Footage(provenance.bag_sha256, tuple(frames))
    observed = load_observations(bag_path, footage)
    told = [observation for _, observation in observed]
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
        sightings=states.sightings,
        tracking_m=states.tracking_m,
        phase_events=phase_events,
        safety=tuple(safety),
        optics=_optics(bag_path) if frames_ns else None,
        attached=attached,
        labels=None if labels_file is None else load_labels(labels_file),
        agreement=agree(told, footage.period_s) if told else None,
        observation_files=tuple(file for file, _ in observed),
    )


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
