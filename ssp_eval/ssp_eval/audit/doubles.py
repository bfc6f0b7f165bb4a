"""Recordings of one audit that are copies of each other: no drive is two domains (METHOD 4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

from ssp_core.names import VUT_ID
from ssp_core.run_file.participation import ParticipantKind
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.audit.evidence.recording import BESIDE_S, Recording
from ssp_eval.audit.examine import Examination
from ssp_eval.data.provenance import Provenance
from ssp_eval.pictures.copies import MOST_PICTURES, Details, details_of, same_pictures
from ssp_eval.pictures.footage import read_quarter, spread
from ssp_eval.recordings.tracks import MOVING_MPS, SameDrive, Track, same_drive, tracks_of

TRACKS = "tracks"
_LONGEST_S = 120.0
# No camera takes one picture twice, and so many need a VUT that moves: a simulator may draw the
# same start again.
_SAME_PICTURES = 10


@dataclass(frozen=True)
class ComparedRecording:
    """One recording, held against those before it.

    Args:
        findings: why it is no other recording than one of them.
        tracks: how its tracks lie to theirs, for people; empty: it has none, or they have none.
    """

    findings: tuple[Finding, ...]
    tracks: str


def hold_apart(examined: Sequence[Examination]) -> list[ComparedRecording]:
    """Find recordings that are another domain's, by their files, sessions, pictures and tracks.

    Two simulated sessions of this project may be equal: their plans come from one K*. What each of
    them comes from is disclosed.
    """
    tracks = [_tracks(one) for one in examined]
    details: dict[int, Details] = {}

    def details_at(index: int) -> Details:
        if index not in details:
            details[index] = _details(examined[index])
        return details[index]

    twins: list[list[str]] = [[] for _ in examined]
    remarks: list[list[str]] = [[] for _ in examined]
    for i, j in combinations(range(len(examined)), 2):
        first, second = examined[i].whole, examined[j].whole
        theirs = first.provenance.domain
        shared = _shared(first.provenance, second.provenance)
        twins[j] += [f"{what} of the {theirs} recording" for what in shared]
        are_simulated = _is_simulated(first.provenance) and _is_simulated(second.provenance)
        pictures = len(_pictures(examined[i]) & _pictures(examined[j]))
        if pictures >= _SAME_PICTURES and not shared and not are_simulated:
            twins[j].append(f"{pictures} of its pictures are those of the {theirs} recording")
        elif not shared and not are_simulated and (like := _alike(details_at(i), details_at(j))):
            twins[j].append(like.format(theirs=theirs))
        if not tracks[i] or not tracks[j]:
            continue
        same = _same(first, second, tracks[i], tracks[j])
        if same is None:
            remarks[j].append(f"another drive than {theirs}")
        elif are_simulated and not shared:
            remarks[j].append(
                f"equal to {theirs}'s ({same.text}), as of two simulated sessions of one K*: "
                f"{_origin(second.provenance)}, and {_origin(first.provenance)}"
            )
        else:
            remarks[j].append(f"equal to {theirs}'s ({same.text})")
            if not shared:
                twins[j].append(f"its tracks are those of the {theirs} recording ({same.text})")
    return [
        ComparedRecording(
            (Finding("same_recording", "; ".join(texts)),) if texts else (),
            "; ".join(lines),
        )
        for texts, lines in zip(twins, remarks, strict=True)
    ]


def _shared(first: Provenance, second: Provenance) -> list[str]:
    """List what two recordings have in common, and which one was made from the other."""
    shared_parts = []
    if first.bag_sha256 == second.bag_sha256:
        shared_parts.append("the bag is that")
    a, b = _sources(first), _sources(second)
    shared_parts += [f"the {what} is that" for what in a if a[what] == b.get(what)]
    if first.bag_sha256 in b.values():
        shared_parts.append("it was made from the bag")
    if second.bag_sha256 in a.values():
        shared_parts.append("its bag is the source")
    if first.run is not None and second.run is not None:
        token = first.run.session_token
        if token and token == second.run.session_token:
            shared_parts.append(f"the session {token} is that")
    return shared_parts


def _sources(facts: Provenance) -> dict[str, str]:
    """Return the hashes of the sources that a recording was imported or drawn from, by name."""
    if facts.redrawing is not None:
        return {"recording that was drawn anew": facts.redrawing.of_sha256}
    record = facts.imported
    if record is None:
        return {}
    states = {} if record.states is None else {"table of states": record.states.sha256}
    source = record.source_sha256
    return states if source is None else {"source file": source, **states}


def _is_simulated(facts: Provenance) -> bool:
    """Return True for a session of ours whose VUT is a model of motion and that played nothing."""
    part = facts.participation
    if part is None:
        return False
    if part.mode != "live":
        return True
    kinds = {kind for who in part.declared for kind in part.kinds_of(who)}
    return (
        part.kinds_of(VUT_ID) == (ParticipantKind.SIMULATED,)
        and ParticipantKind.PLAYED not in kinds
    )


def _origin(facts: Provenance) -> str:
    """Session, site and seed, for people."""
    run = facts.run
    name = "" if run is None else run.session_token
    return f"{facts.origin} ({name})" if name else facts.origin


def _pictures(one: Examination) -> set[bytes]:
    """Return the digests of the pictures in the clip, without those of a VUT that stands."""
    return {one.recording.digests[index] for index in _moving(one)}


def _moving(one: Examination) -> list[int]:
    """Return the indices of the frames of the clip, without those of a VUT that stands."""
    who = one.recording.provenance.participants
    return [
        index
        for index, moment in enumerate(one.moments)
        if who is None
        or who.vut not in moment.states
        or abs(moment.states[who.vut].speed_mps) > MOVING_MPS
    ]


def _details(one: Examination) -> Details:
    """Return the fine detail of the pictures in the clip, without those of a VUT that stands."""
    recording = one.recording
    frames = spread(_moving(one), MOST_PICTURES)
    if not frames:
        return details_of({})
    return details_of(
        read_quarter(recording.path, one.moments, recording.provenance, frozenset(frames))
    )


def _alike(first: Details, second: Details) -> str:
    """Return a sentence about pictures that were encoded anew; empty: they are others."""
    count = same_pictures(first, second)
    if not count:
        return ""
    least = min(len(first), len(second))
    return f"{count} of {least} pictures are those of the {{theirs}} recording, encoded anew"


_Views = list[dict[str, Track]]


def _tracks(one: Examination) -> _Views:
    """Return the tracks of VUT and objects in and near the clip, by kind of source."""
    who, whole = one.whole.provenance.participants, one.whole
    if who is None or not whole.sightings:
        return []
    start_s = one.crop.start_s if one.crop is not None else (whole.start_s or 0.0)
    end_s = one.crop.end_s if one.crop is not None else start_s + _LONGEST_S
    end_s = min(end_s, start_s + _LONGEST_S)
    # Beside the clip too, so that the same drive is found where another part of it was kept.
    near = (s for s in whole.sightings if start_s - BESIDE_S <= s.t_s <= end_s + BESIDE_S)
    return tracks_of(near, who.ids)


def _same(first: Recording, second: Recording, a: _Views, b: _Views) -> SameDrive | None:
    ids = [one.provenance.participants for one in (first, second)]
    if ids[0] is None or ids[1] is None:
        return None
    vut = ids[0].vut, ids[1].vut
    drives = [same_drive(one, other, vut) for one, other in product(a, b)]
    return min((one for one in drives if one is not None), key=lambda one: one.rms_m, default=None)
