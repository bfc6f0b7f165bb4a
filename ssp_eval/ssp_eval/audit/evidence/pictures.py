"""Comparison of a recording's pictures with its states: the checks, and their findings."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ssp_eval.audit.evidence.evidence import Subject
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.data.audit import PicturesEntry
from ssp_eval.pictures.compare import PictureFigures, compare_pictures, plan_pairs
from ssp_eval.pictures.footage import Float32, Footage, read_grey, read_small
from ssp_eval.pictures.ground import Pair
from ssp_eval.pictures.repeats import has_many_repeats, repeated_frames, sampled_frames

REMEDY = (
    "video, states, their common time and the camera's geometry must be of one drive, and the "
    "pictures neither mirrored nor turned"
)


@dataclass(frozen=True)
class PictureExamination:
    """Comparison of a clip's pictures with its states.

    Args:
        entry: all figures, or why there are none.
        findings: one where a figure lies outside its limits.
        road: pairs of frames in which the road was compared, for a picture of them.
    """

    entry: PicturesEntry
    findings: tuple[Finding, ...] = ()
    road: tuple[Pair, ...] = ()


def _nothing(why: str) -> PictureExamination:
    return PictureExamination(PicturesEntry(note=why))


def examine_pictures(one: Subject) -> PictureExamination:
    """Compare the pictures of a clip with its states.

    Raises:
        InputError: a frame is no picture.
    """
    recording = one.recording
    who, optics = recording.provenance.participants, recording.optics
    if not recording.frames_s:
        return _nothing("there are no pictures")
    if who is None or not recording.series:
        return _nothing("there are no states to compare the pictures with")
    if optics is None or recording.provenance.camera == "assumed":
        what = "is a guess" if optics is not None else "is not recorded"
        return _nothing(f"the camera's geometry {what}")
    repeated = _repeated(one, who.vut)
    plan = plan_pairs(one.moments, optics, who.vut, who.targets, repeated)
    grey = read_grey(recording.path, one.moments, recording.provenance, plan.frame_indices)
    if not grey:
        return _nothing("no frame has a state of the VUT at its time")
    lanes = None if recording.road is None else recording.road.road
    figures = compare_pictures(Footage(one.moments, grey, optics, who.vut), plan, lanes)
    return PictureExamination(
        PicturesEntry(checks=list(figures.checks)), _findings(figures), figures.road
    )


def _repeated(one: Subject, vut_id: str) -> frozenset[int]:
    """Find the frames that repeat the one before, where a sample has many of them."""

    def read(indices: Collection[int]) -> dict[int, Float32]:
        return read_small(one.recording.path, one.moments, one.recording.provenance, indices)

    if not has_many_repeats(read(sampled_frames(one.moments, vut_id)), one.moments, vut_id):
        return frozenset()
    return repeated_frames(read(range(len(one.moments))), one.moments, vut_id)


def _findings(figures: PictureFigures) -> tuple[Finding, ...]:
    failing = [check for check in figures.checks if check.state == "fails"]
    if not failing:
        return ()
    detail = "; ".join(
        f"{check.name}: {check.told} (limit {check.limit}, {check.judged} pairs of frames)"
        for check in failing
    )
    return (Finding("pictures_differ", f"{detail}; {REMEDY}"),)
