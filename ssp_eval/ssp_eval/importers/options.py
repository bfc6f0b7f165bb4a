"""Options that both importers share: what persons declare of a recording, frames, sizes, road."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from typing import Any, get_args

import click

from ssp_core.errors import InputError
from ssp_core.motion.state import Size
from ssp_core.options import Domain
from ssp_core.vocabulary import DomainWord, ObjectClass, Role
from ssp_eval.data.provenance import SAFE_NAME, DomainDeclaration, LogDeclaration
from ssp_eval.importers.tracks import Body, ReferencePoint, Rigid, size_of
from ssp_scenario_manager.event_spec.load import load_event, read_event_file
from ssp_scenario_manager.event_spec.model import Event

_NAME = re.compile(SAFE_NAME)
_VERSION = re.compile(r"sha256:[0-9a-f]{64}")


@dataclass(frozen=True)
class Declared:
    """What is said of a recording and can't be read in it.

    Args:
        domain: of METHOD 5.2.
        scenario: None: not stated.
        event_version: K* version, None: not stated.
        event: the K* itself, where it was given.
        event_file: its bytes.
        generator: what made the recording, free text.
        declaration: who says of which domain it is; None: nobody does.
        log: what a named person declares in place of a log; None: nobody does.
    """

    domain: DomainWord = "synthetic"
    scenario: str | None = None
    event_version: str | None = None
    event: Event | None = None
    event_file: bytes | None = None
    generator: str = "unknown"
    declaration: DomainDeclaration | None = None
    log: LogDeclaration | None = None

    def check_ids(self, ids: tuple[str, ...]) -> None:
        """Raises InputError where an object has an id that the K* doesn't know, or lacks one."""
        if self.event is None or not ids:
            return
        wanted = sorted(self.event.participants)
        if sorted(ids) != wanted:
            raise InputError(
                f"has the objects {', '.join(sorted(ids))}, the K* {self.event.name} has "
                f"{', '.join(wanted)}",
                field="--object",
                remedy="name each of its participants with --object, by the K*'s ids",
            )


NOTHING = Declared()


def _matching(
    pattern: re.Pattern[str], what: str
) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    def check(_: click.Context, __: click.Parameter, value: str | None) -> str | None:
        if value is not None and not pattern.fullmatch(value):
            raise click.BadParameter(f"{value!r} is no {what}")
        return value

    return check


class Day(click.ParamType[date]):
    """A date, YYYY-MM-DD."""

    name = "date"

    def convert(
        self, value: str | date, param: click.Parameter | None, ctx: click.Context | None
    ) -> date:
        if isinstance(value, date):
            return value
        try:
            return date.fromisoformat(value)
        except ValueError:
            self.fail(f"{value!r} is no date; give YYYY-MM-DD", param, ctx)


_YES_NO = click.Choice(["yes", "no"])
_OPTIONS: tuple[Callable[[Any], Any], ...] = (
    click.option(
        "--scenario",
        callback=_matching(_NAME, "name of letters, digits, _ . and -"),
        help="Name of the scenario.",
    ),
    click.option(
        "--event-version",
        callback=_matching(_VERSION, "sha256:<64 hex digits>"),
        help="K* version that the recording shows.",
    ),
    click.option(
        "--event", help="The K* itself, by name or file: gives scenario and version, is attached."
    ),
    click.option(
        "--generator", default="unknown", show_default=True, help="What made the recording."
    ),
    click.option("--declared-by", help="Who says of which domain it is."),
    click.option("--declared-on", type=Day(), help="When it was recorded, YYYY-MM-DD."),
    click.option("--place", help="Where it was recorded."),
    click.option("--log-by", help="Who declares what only a log would show."),
    click.option("--log-on", type=Day(), help="When he does [default: today]."),
    click.option("--safety-abort", type=_YES_NO, help="Was there a safety abort?"),
    click.option("--identity-switch", type=_YES_NO, help="Was an object taken for another?"),
    click.option("--site-change", multiple=True, help="What was changed on site; or: none."),
)


def declaring(domain_default: str | None) -> Callable[[Any], Any]:
    """Adds the options; the command takes them as keywords for ``declared``.

    Args:
        domain_default: None: the domain must be given.
    """

    def add(function: Any) -> Any:
        # A default of None would count as one.
        default: dict[str, Any] = {} if domain_default is None else {"default": domain_default}
        domain = click.option(
            "--domain",
            type=Domain(),
            required=domain_default is None,
            show_default=True,
            help="synthetic, simulation or physical.",
            **default,
        )
        for option in reversed((domain, *_OPTIONS)):
            function = option(function)
        return function

    return add


def declared(
    *,
    domain: DomainWord,
    scenario: str | None,
    event_version: str | None,
    event: str | None,
    generator: str,
    declared_by: str | None,
    declared_on: date | None,
    place: str | None,
    log_by: str | None,
    log_on: date | None,
    safety_abort: str | None,
    identity_switch: str | None,
    site_change: tuple[str, ...],
) -> Declared:
    """The options of ``declaring`` as one.

    Raises:
        UsageError: what belongs together isn't given together.
        InputError: the K* can't be read.
    """
    found, data = None, None
    if event is not None:
        if scenario is not None or event_version is not None:
            raise click.UsageError("--event gives --scenario and --event-version by itself")
        found, event_version = load_event(event)
        scenario = found.name
        data = read_event_file(event)[1].read_bytes()
    return Declared(
        domain,
        scenario,
        event_version,
        found,
        data,
        generator,
        _declaration(declared_by, declared_on, place),
        _log(log_by, log_on, safety_abort, identity_switch, site_change),
    )


def _text(option: str, text: str) -> str:
    if not text.strip() or len(text) > 500:
        raise click.UsageError(f"{option} needs 1 to 500 characters that aren't all blank")
    return text.strip()


def _declaration(by: str | None, on: date | None, place: str | None) -> DomainDeclaration | None:
    if by is None and on is None and place is None:
        return None
    if by is None or on is None or place is None:
        raise click.UsageError(
            "--declared-by NAME, --declared-on DATE and --place TEXT belong together: a domain is "
            "declared by a person with date and place"
        )
    if on > datetime.now(UTC).date():
        raise click.UsageError(f"--declared-on {on.isoformat()} lies in the future")
    return DomainDeclaration(by=_text("--declared-by", by), on=on, place=_text("--place", place))


def _log(
    by: str | None,
    on: date | None,
    abort: str | None,
    switch: str | None,
    changes: tuple[str, ...],
) -> LogDeclaration | None:
    if by is None and on is None and abort is None and switch is None and not changes:
        return None
    if by is None or abort is None or switch is None or not changes:
        raise click.UsageError(
            "--log-by NAME, --safety-abort yes|no, --identity-switch yes|no and --site-change "
            "TEXT|none belong together: what isn't declared is unknown"
        )
    if "none" in changes and len(changes) > 1:
        raise click.UsageError("--site-change none stands alone")
    return LogDeclaration(
        by=_text("--log-by", by),
        on=datetime.now(UTC).date() if on is None else on,
        safety_abort=abort == "yes",
        identity_switch=switch == "yes",
        site_changes=[] if changes == ("none",) else [_text("--site-change", c) for c in changes],
    )


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


_MOTION_OPTIONS: tuple[Callable[[Any], Any], ...] = (
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
    for option in reversed(_MOTION_OPTIONS):
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
