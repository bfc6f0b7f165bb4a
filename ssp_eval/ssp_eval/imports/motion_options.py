"""Options about the objects' motion that both importers share: frames, sizes, road."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

import click

from ssp_core.motion.state import Size
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.imports.tracks import Body, ReferencePoint, Rigid, size_of

ALL = "all"
_ID = re.compile(r"[a-z][a-z0-9_]{0,31}")


@dataclass(frozen=True)
class MotionOptions:
    """What is said of the objects' motion.

    Args:
        transforms: by id, ``all`` for those that aren't named.
        references: which point of an object is reported, by id.
        from_motion: ids whose heading is their direction of motion.
        sizes: length, width, height in m, by id.
        site: map or site file, None: none is bound.
        block: of it, None: the one under the VUT's way.
    """

    transforms: Mapping[str, Rigid] = field(default_factory=dict)
    references: Mapping[str, ReferencePoint | float] = field(default_factory=dict)
    from_motion: frozenset[str] = frozenset()
    sizes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    site: str | None = None
    block: str | None = None

    def body(
        self,
        object_id: str,
        object_class: ObjectClass,
        role: Role,
        reference: ReferencePoint,
        size: Size | None = None,
    ) -> Body:
        """What is known of one object.

        Args:
            object_id: in the recording that is made.
            object_class: word.
            role: in the event.
            reference: the point that the source reports where nobody says otherwise.
            size: that the source gives.
        """
        if object_id in self.sizes:
            size = size_of(object_class, *self.sizes[object_id])
        return Body(
            object_id,
            object_class,
            role,
            size,
            self.references.get(object_id, self.references.get(ALL, reference)),
            object_id in self.from_motion or ALL in self.from_motion,
            self.transforms.get(object_id, self.transforms.get(ALL, Rigid())),
        )

    def check_ids(self, ids: tuple[str, ...]) -> None:
        """Raises UsageError where an option names nobody."""
        for option, named in (
            ("--transform", self.transforms),
            ("--reference", self.references),
            ("--heading", self.from_motion),
            ("--size", self.sizes),
        ):
            for name in named:
                if name not in (*ids, ALL):
                    raise click.UsageError(f"{option} {name}=…: the objects are {', '.join(ids)}")


_OPTIONS: tuple[Callable[[Any], Any], ...] = (
    click.option("--site", help="OpenDRIVE map, SUMO network or site: the road, for topology."),
    click.option("--block", help="The stretch of it that the VUT drives on, where several fit."),
    click.option(
        "--transform",
        "transforms",
        multiple=True,
        metavar="ID=X,Y,YAW_DEG",
        help="Rigid motion from an object's frame (or `all`) to the map's: m and degrees.",
    ),
    click.option(
        "--reference",
        "references",
        multiple=True,
        metavar="ID=POINT",
        help="The point that an object's poses (or those of `all`) are of: rear_axle, centre, "
        "front, rear, or m ahead of the rear axle [default: a bag's rear_axle, a table's centre].",
    ),
    click.option(
        "--heading",
        "headings",
        multiple=True,
        metavar="ID=motion",
        help="Take an object's heading (or that of `all`) from its direction of motion.",
    ),
)


def moving(function: Any) -> Any:
    """Adds the options; the command takes them as keywords for ``motion_options``."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function


def motion_options(
    site: str | None,
    block: str | None,
    transforms: tuple[str, ...],
    references: tuple[str, ...],
    headings: tuple[str, ...],
    sizes: tuple[str, ...] = (),
) -> MotionOptions:
    """The options of ``moving`` as one; raises UsageError for what has no sense."""
    if block is not None and site is None:
        raise click.UsageError("--block is of no use without --site")
    for name, what in pairs("--heading", headings).items():
        if what != "motion":
            raise click.UsageError(f"--heading {name}={what}: it can only be taken from `motion`")
    return MotionOptions(
        {name: rigid(text) for name, text in pairs("--transform", transforms).items()},
        {name: _reference(text) for name, text in pairs("--reference", references).items()},
        frozenset(pairs("--heading", headings)),
        {name: _size(text) for name, text in pairs("--size", sizes).items()},
        site,
        block,
    )


def pairs(option: str, given: tuple[str, ...]) -> dict[str, str]:
    """ID=VALUE options by id; raises UsageError for another form, or an id twice."""
    found: dict[str, str] = {}
    for text in given:
        name, sign, value = text.partition("=")
        if not sign or not _ID.fullmatch(name) or not value:
            raise click.UsageError(
                f"{option} {text}: give ID=VALUE, ID of a-z, 0-9 and _, such as ot1"
            )
        if name in found:
            raise click.UsageError(f"{option} names {name} twice")
        found[name] = value
    return found


def numbers(option: str, text: str, names: str, least: int | None = None) -> list[float]:
    """Finite numbers with commas between them.

    Args:
        option: for messages.
        text: given.
        names: of the numbers, with commas.
        least: how many must be there, None: all.

    Raises:
        UsageError: it is something else.
    """
    wanted = names.split(",")
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not (least or len(wanted)) <= len(found) <= len(wanted) or not all(
        map(math.isfinite, found)
    ):
        raise click.UsageError(f"{option} {text}: give {names} as numbers")
    return found


def rigid(text: str) -> Rigid:
    """X,Y,YAW_DEG as a rigid motion."""
    x_m, y_m, yaw_deg = numbers("--transform", text, "X,Y,YAW_DEG")
    return Rigid(x_m, y_m, math.radians(yaw_deg))


def _reference(text: str) -> ReferencePoint | float:
    for word in get_args(ReferencePoint):
        if text == word:
            point: ReferencePoint = word
            return point
    try:
        ahead_m = float(text)
    except ValueError:
        ahead_m = math.nan
    if not abs(ahead_m) <= 20.0:
        raise click.UsageError(
            f"--reference …={text}: give {', '.join(get_args(ReferencePoint))} or a number of m "
            "ahead of the rear axle"
        )
    return ahead_m


def _size(text: str) -> tuple[float, float, float]:
    length_m, width_m, height_m = numbers("--size", text.replace("x", ","), "LENGTH,WIDTH,HEIGHT")
    if not all(0.0 < extent <= 40.0 for extent in (length_m, width_m, height_m)):
        raise click.UsageError(f"--size …={text}: each above 0 and up to 40 m")
    return length_m, width_m, height_m
