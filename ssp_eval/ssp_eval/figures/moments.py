"""The moments of a cell, per label time: its frame, plan, recorded path and words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.errors import InputError
from ssp_eval.data.ego_path import NS, EgoPath, recorded_paths
from ssp_eval.data.labels import Label
from ssp_eval.data.records import BehaviourRecord
from ssp_eval.evaluate.store.cell_file import frame_path
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.figures.projection import Ribbon, ribbon
from ssp_eval.score.cell import Judgement
from ssp_eval.score.cli import NULL
from ssp_vla_bridge.trajectory import Trajectory

Image = NDArray[np.uint8]

_HORIZON_S = 3.0
RIGHT, WRONG = "✓", "✗"


@dataclass(frozen=True)
class Moment:
    """One label time of a cell.

    Args:
        stamp_ns: of the request, None where nothing was asked.
        frames: stamp and hash of each frame sent, oldest first.
        record: the answer, None where there is none.
        plan: the valid trajectory, None: there is none.
    """

    label: Label
    judgement: Judgement
    stamp_ns: int | None
    frames: tuple[tuple[int, str], ...]
    record: BehaviourRecord | None
    plan: Trajectory | None

    @property
    def says(self) -> str:
        """The actions that the text commits to, marked right or wrong."""
        judgement = self.judgement
        return _actions(judgement.text_lon, judgement.text_lat, self.label)

    @property
    def plans(self) -> str:
        """The actions that the trajectory makes, marked right or wrong."""
        judgement = self.judgement
        return _actions(judgement.trajectory_lon, judgement.trajectory_lat, self.label)

    @property
    def allowed(self) -> str:
        """The actions that are right here."""
        return f"{' / '.join(self.label.lon_actions)}, {' / '.join(self.label.lat_actions)}"


def _actions(lon: str | None, lat: str | None, label: Label) -> str:
    if lon is None and lat is None:
        return NULL
    mark = RIGHT if lon in label.lon_actions and lat in label.lat_actions else WRONG
    return f"{lon or NULL}, {lat or NULL} {mark}"


@dataclass(frozen=True)
class CellMoments:
    """A scored cell with its label times and what was driven."""

    cell: CellData
    out: Path
    moments: tuple[Moment, ...]

    @cached_property
    def path(self) -> EgoPath:
        """Return the VUT's path, as far as the requests state it."""
        requests = [r for r in self.cell.requests if r.get("ego_provenance") != "unknown"]
        return EgoPath(tuple(map(tuple, recorded_paths(requests))))

    @property
    def ego_provenance(self) -> str:
        """Return how the recorded path is known: measured, declared or unknown."""
        return self.cell.facts.clip.ego

    @property
    def sees_ground(self) -> bool:
        """True where the camera's pose is known, so that a path can be drawn on the picture."""
        geometry = self.cell.facts.clip.geometry
        return (
            geometry is not None
            and geometry.height_m is not None
            and geometry.pitch_down_rad is not None
            and self.cell.facts.clip.mount_forward_m is not None
        )

    def ribbon_of(self, path: Trajectory | None) -> Ribbon | None:
        """Return a path in the ego frame as the camera shows it."""
        clip = self.cell.facts.clip
        if path is None or clip.geometry is None:
            return None
        turn = (clip.mount_left_m, clip.mount_yaw_left_rad, clip.mount_roll_right_rad)
        return ribbon(path, clip.geometry.model_dump(), clip.mount_forward_m, turn)

    def recorded(self, at_ns: int) -> Trajectory | None:
        """Return the path that was driven from a time on."""
        return self.path.after(at_ns * NS, _HORIZON_S)

    def picture(self, sha256: str) -> Image:
        """Return a frame that was sent, BGR, at the size that the camera's geometry is for.

        Raises:
            InputError: it isn't there or is no picture.
        """
        file = frame_path(self.out, sha256)
        try:
            data = np.frombuffer(file.read_bytes(), np.uint8)
        except OSError as error:
            raise InputError(
                f"can't be read: {error.strerror}",
                file=file,
                remedy="put the frame back, or evaluate the cell again",
            ) from error
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
        if image is None:
            raise InputError(
                "is no picture", file=file, remedy="put the frame back, or evaluate the cell again"
            )
        geometry = self.cell.facts.clip.geometry
        if geometry is not None and image.shape[:2] != (geometry.height_px, geometry.width_px):
            image = cv2.resize(image, (geometry.width_px, geometry.height_px))
        return np.asarray(image, np.uint8)


def cell_moments(cell: CellData, out: Path) -> CellMoments | None:
    """Return the label times of a cell; None unless it has scores."""
    if cell.score is None:
        return None
    requests = cell.requests_by_label()
    judgements = zip(cell.labels.labels, cell.score.details.judgements, strict=True)
    return CellMoments(
        cell,
        out,
        tuple(
            _moment(cell, label, judgement, requests.get(label.t_s, {}))
            for label, judgement in judgements
        ),
    )


def _moment(
    cell: CellData, label: Label, judgement: Judgement, request: Mapping[str, Any]
) -> Moment:
    record = None if judgement.record is None else cell.records[judgement.record]
    valid = record is not None and judgement.trajectory_valid
    stamp = request.get("stamp_ns")
    return Moment(
        label=label,
        judgement=judgement,
        stamp_ns=None if stamp is None else int(stamp),
        frames=tuple(
            (int(frame["stamp_ns"]), str(frame["sha256"])) for frame in request.get("frames", ())
        ),
        record=record,
        plan=record.trajectory if record is not None and valid else None,
    )
