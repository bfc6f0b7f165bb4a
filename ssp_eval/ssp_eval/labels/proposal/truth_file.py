"""``ssp.truth/1``: what the maker of a clip knows of it, as the ground truth of label proposals.

Only label proposals and boxes read it. No request is ever built from it.
"""

from __future__ import annotations

import json
import math
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Field

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import parse_model, read_text
from ssp_core.motion.state import ObjectState, Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.run_file.values import Strict
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.labels.proposal.basis import Truth
from ssp_eval.labels.proposal.k_star import UNKNOWN_VERSION, KStar, rules_of

Word = TypeVar("Word", bound=IntEnum)


class TruthSize(Strict):
    """Extent from the reference point, m."""

    front_m: float
    rear_m: float
    width_m: float
    height_m: float


class TruthObject(Strict):
    """One object of a truth file, fields as in ssp_core.motion.state.ObjectState."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    object_id: str
    object_class: int | str
    role: int | str = int(Role.UNKNOWN)
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float = 0.0
    yaw_rate_radps: float = 0.0
    size: TruthSize


class TruthFrame(Strict):
    """All objects at one clip time."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    t_s: float
    objects: list[TruthObject]


class TruthCamera(Strict):
    """The clip's camera, as far as labels need it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    hfov_deg: Annotated[float, Field(gt=1, lt=180)] | None = None


class TruthFile(Strict):
    """``ssp.truth/1``: what the maker of a clip knows about it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    schema_: Literal["ssp.truth/1"] = Field(alias="schema")
    scenario: str
    domain: str = "synthetic"
    event_version: str | None = None
    camera: TruthCamera = TruthCamera()
    frames: Annotated[list[TruthFrame], Field(min_length=1)]


def truth_from_file(
    path: str | Path,
    domain: str | None = None,
    event_version: str | None = None,
    given: KStar | None = None,
) -> Truth:
    """Ground truth that a clip's maker wrote beside it, in the clip's own time.

    Args:
        path: the truth file.
        domain: of the clip, where it isn't the one that the file names (METHOD 5.2).
        event_version: K* version, where the file names none.
        given: the K*, for its rules. Where it isn't given, the shipped K* of this scenario is
            taken, unless another version is named.

    Raises:
        InputError: it is not valid, or the frames' times don't rise.
    """
    # Such a file is large, and always JSON: the YAML reader would take seconds.
    try:
        value = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"is no JSON: {error}", file=path) from error
    found = parse_model(TruthFile, value, path)
    for before, after in pairwise(found.frames):
        if after.t_s <= before.t_s:
            raise InputError("must rise strictly", file=path, field="frames.t_s", value=after.t_s)
    series = [(f.t_s, [_object(o, f.t_s, path) for o in f.objects]) for f in found.frames]
    first = series[0][1]
    targets = tuple(state.object_id for state in first if state.role is Role.OT)
    version = found.event_version or event_version or UNKNOWN_VERSION
    rules = rules_of(given, None, found.scenario, version)
    return Truth(
        scenario=found.scenario,
        domain=domain or found.domain,
        event_version=version,
        start_s=series[0][0],
        end_s=series[-1][0],
        vut_id=next((s.object_id for s in first if s.role is Role.VUT), VUT_ID),
        target_ids=targets or tuple(s.object_id for s in first if s.object_id != VUT_ID),
        series=series,
        source=str(path),
        hfov_rad=None if found.camera.hfov_deg is None else math.radians(found.camera.hfov_deg),
        thresholds=rules.thresholds or ConflictThresholds(),
        observable=rules.observable,
        rules_of=rules.said_by,
        frames_s=tuple(t_s for t_s, _ in series),
        window=rules.window,
    )


def _object(found: TruthObject, t_s: float, path: str | Path) -> ObjectState:
    return ObjectState(
        object_id=found.object_id,
        object_class=_member(ObjectClass, found.object_class, "object_class", path),
        role=_member(Role, found.role, "role", path),
        stamp_ns=seconds_to_ns(t_s),
        x_m=found.x_m,
        y_m=found.y_m,
        yaw_rad=found.yaw_rad,
        speed_mps=found.speed_mps,
        acceleration_mps2=found.acceleration_mps2,
        yaw_rate_radps=found.yaw_rate_radps,
        size=Size(**found.size.model_dump()),
    )


def _member(enum: type[Word], given: int | str, field: str, path: str | Path) -> Word:
    """The member of an enumeration by its number or its word."""
    try:
        return enum[given.upper()] if isinstance(given, str) else enum(given)
    except (KeyError, ValueError):
        words = ", ".join(member.name.lower() for member in enum)
        raise InputError(
            "is not known", file=path, field=field, value=given, remedy=f"known are {words}"
        ) from None
