"""Options that both importers share: crop, frames, sizes, road, and what persons declare."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any, get_args

import click

from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.motion.state import Size
from ssp_core.options import Domain
from ssp_core.vocabulary import DomainWord, ObjectClass, Role
from ssp_eval.data.provenance import SAFE_NAME, DomainDeclaration, LogDeclaration
from ssp_eval.importers.findings import ACCEPTABLE
from ssp_eval.importers.tracks import Body, ReferencePoint, Rigid, size_of
from ssp_scenario_manager.event_spec.load import load_event, read_event_file
from ssp_scenario_manager.event_spec.model import Event

Option = Callable[[Any], Any]
ALL = "all"
OBJECT_ID = re.compile(r"[a-z][a-z0-9_]{0,31}")


@dataclass(frozen=True)
class DeclaredFacts:
    """The declared facts about a recording that can't be read in it.

    Args:
        event: the K* itself, where it was given.
        declaration: who says of which domain it is; None: no person does.
        log: what a named person declares in place of a log; None: no person does.
    """

    domain: DomainWord
    scenario: str | None
    event_version: str | None
    event: Event | None
    event_file: bytes | None
    generator: str
    declaration: DomainDeclaration | None
    log: LogDeclaration | None


@dataclass(frozen=True)
class MotionOptions:
    """The declared facts about the objects' motion.

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
        reference: ReferencePoint,
        role: Role,
        size: Size | None = None,
    ) -> Body:
        """Describe an object; declarations replace ``reference`` and ``size`` of the source."""
        if object_id in self.sizes:
            size = size_of(object_class, *self.sizes[object_id])
        return Body(
            object_id,
            object_class,
            role,
            size,
            self.references.get(object_id, self.references.get(ALL, reference)),
            bool({object_id, ALL} & self.from_motion),
            self.transforms.get(object_id, self.transforms.get(ALL, Rigid())),
        )


@dataclass(frozen=True)
class ImportOptions:
    """The options of both importers.

    Args:
        start_s: crop: of a video source time, of a bag from the camera's first frame on.
        end_s: as start_s, exclusive for a video; None: all.
        rate_hz: at least this many frames per second are kept, None: at least 10 where the source
            has them.
        accepted: names of findings that are taken as they are.
    """

    out: Path
    start_s: float
    end_s: float | None
    rate_hz: float | None
    motion: MotionOptions
    declared: DeclaredFacts
    accepted: tuple[str, ...] = ()

    def check_ids(self, ids: tuple[str, ...]) -> None:
        """Check the objects' ids.

        Raises:
            UsageError: an option names an id that isn't there.
            InputError: the objects aren't those of the K*.
        """
        for option, option_ids in (
            ("--transform", self.motion.transforms),
            ("--reference", self.motion.references),
            ("--heading", self.motion.from_motion),
            ("--size", self.motion.sizes),
        ):
            for name in option_ids:
                if name not in (*ids, ALL):
                    raise click.UsageError(f"{option} {name}=…: the objects are {', '.join(ids)}")
        event = self.declared.event
        if event is not None and set(ids) != set(event.participants):
            raise InputError(
                f"has the objects {', '.join(sorted(ids))}, the K* {event.name} has "
                f"{', '.join(sorted(event.participants))}",
                field="--object",
                remedy="name each of its participants with --object, by the K*'s ids",
            )


def import_options(out: Path, arguments: Mapping[str, Any]) -> ImportOptions:
    """Return the options of ``declaring`` and ``moving``, and those about the crop, as one.

    Raises:
        UsageError: one makes no sense, or what belongs together isn't given together.
        InputError: the K* can't be read.
    """
    start_s, end_s = arguments["start"], arguments["end"]
    if end_s is not None and start_s >= end_s:
        raise click.UsageError(f"--start {start_s:g} must lie before --end {end_s:g}")
    return ImportOptions(
        out,
        start_s,
        end_s,
        arguments["rate"],
        _motion(arguments),
        _declared(arguments),
        arguments["accepted"],
    )


def adding(*options: Option) -> Option:
    """Return one decorator that adds several options."""

    def add(function: Any) -> Any:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def _matching(
    pattern: str, what: str
) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    def check(_: click.Context, __: click.Parameter, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(pattern, value):
            raise click.BadParameter(f"{value!r} is no {what}")
        return value

    return check


_DAY = click.DateTime(["%Y-%m-%d"])
_YES_NO = click.Choice(["yes", "no"])
declaring = adding(
    click.option(
        "--scenario",
        callback=_matching(SAFE_NAME, "name of letters, digits, _ . and -"),
        help="Name of the scenario.",
    ),
    click.option(
        "--event-version",
        callback=_matching(r"sha256:[0-9a-f]{64}", "sha256:<64 hex digits>"),
        help="K* version that the recording shows.",
    ),
    click.option(
        "--event",
        help="The K* itself, by name or file; it gives scenario and version and is attached.",
    ),
    click.option(
        "--generator", default="unknown", show_default=True, help="What made the recording."
    ),
    click.option("--declared-by", help="Who declares the domain."),
    click.option(
        "--declared-on", type=_DAY, metavar="DATE", help="When it was recorded, YYYY-MM-DD."
    ),
    click.option("--place", help="Where it was recorded."),
    click.option("--log-by", help="Who declares what only a log would show."),
    click.option(
        "--log-on", type=_DAY, metavar="DATE", help="Date of that declaration [default: today]."
    ),
    click.option("--safety-abort", type=_YES_NO, help="Was there a safety abort?"),
    click.option("--identity-switch", type=_YES_NO, help="Was an object mistaken for another?"),
    click.option(
        "--site-change",
        "site_changes",
        multiple=True,
        help="What was changed on site; or: none.",
    ),
)


def domain_option(default: str | None) -> Option:
    """Return ``--domain``; with a default of None it must be given."""
    # A default of None would count as one.
    more: dict[str, Any] = {} if default is None else {"default": default}
    return click.option(
        "--domain",
        type=Domain(),
        required=default is None,
        show_default=True,
        help="synthetic, simulation or physical.",
        **more,
    )


def _declared(arguments: Mapping[str, Any]) -> DeclaredFacts:
    scenario, version, event, data = arguments["scenario"], arguments["event_version"], None, None
    if arguments["event"] is not None:
        if scenario is not None or version is not None:
            raise click.UsageError("--event gives --scenario and --event-version by itself")
        event, version = load_event(arguments["event"])
        scenario, data = event.name, read_event_file(arguments["event"])[1].read_bytes()
    return DeclaredFacts(
        arguments["domain"],
        scenario,
        version,
        event,
        data,
        arguments["generator"],
        _declaration(arguments["declared_by"], arguments["declared_on"], arguments["place"]),
        _log(arguments),
    )


def _today() -> date:
    return datetime.now(UTC).date()


def _text(option: str, text: str) -> str:
    if not text.strip() or len(text) > 500:
        raise click.UsageError(f"{option} needs 1 to 500 characters that aren't all blank")
    return text.strip()


def _declaration(
    by: str | None, on: datetime | None, place: str | None
) -> DomainDeclaration | None:
    if by is None and on is None and place is None:
        return None
    if by is None or on is None or place is None:
        raise click.UsageError(
            "--declared-by NAME, --declared-on DATE and --place TEXT belong together: a domain is "
            "declared by a person with date and place"
        )
    if on.date() > _today():
        raise click.UsageError(f"--declared-on {on.date().isoformat()} lies in the future")
    return DomainDeclaration(
        by=_text("--declared-by", by), on=on.date(), place=_text("--place", place)
    )


def _log(arguments: Mapping[str, Any]) -> LogDeclaration | None:
    names = ("log_by", "safety_abort", "identity_switch", "site_changes")
    by, abort, switch, changes = needed = [arguments[name] for name in names]
    if not any((*needed, arguments["log_on"])):
        return None
    if not all(needed):
        raise click.UsageError(
            "--log-by NAME, --safety-abort yes|no, --identity-switch yes|no and --site-change "
            "TEXT|none belong together: what isn't declared is unknown"
        )
    if "none" in changes and len(changes) > 1:
        raise click.UsageError("--site-change none stands alone")
    return LogDeclaration(
        by=_text("--log-by", by),
        on=_today() if arguments["log_on"] is None else arguments["log_on"].date(),
        safety_abort=abort == "yes",
        identity_switch=switch == "yes",
        site_changes=[] if changes == ("none",) else [_text("--site-change", c) for c in changes],
    )


moving = adding(
    click.option("--site", help="OpenDRIVE map, SUMO network or site: the road, for topology."),
    click.option("--block", help="Block or route of it that the VUT drives on."),
    click.option(
        "--transform",
        "transforms",
        multiple=True,
        metavar="ID=X,Y,YAW_DEG",
        help="Rigid transform from an object's frame (or `all`) to the map's: m and degrees.",
    ),
    click.option(
        "--reference",
        "references",
        multiple=True,
        metavar="ID=POINT",
        help="Point that an object's poses (or those of `all`) refer to: rear_axle, centre, "
        "front, rear, or m ahead of the rear axle [default: a bag's rear_axle, a table's "
        "centre].",
    ),
    click.option(
        "--heading",
        "headings",
        multiple=True,
        metavar="ID=motion",
        help="Take an object's heading (or that of `all`) from its direction of motion.",
    ),
)


def _motion(arguments: Mapping[str, Any]) -> MotionOptions:
    if arguments["block"] is not None and arguments["site"] is None:
        raise click.UsageError("--block is of no use without --site")
    headings = pairs("--heading", arguments["headings"])
    for name, what in headings.items():
        if what != "motion":
            raise click.UsageError(f"--heading {name}={what}: it can only be taken from `motion`")
    return MotionOptions(
        {
            name: _rigid(text)
            for name, text in pairs("--transform", arguments["transforms"]).items()
        },
        {
            name: _point(text)
            for name, text in pairs("--reference", arguments["references"]).items()
        },
        frozenset(headings),
        {name: _size(text) for name, text in pairs("--size", arguments.get("sizes", ())).items()},
        arguments["site"],
        arguments["block"],
    )


def pairs(option: str, arguments: tuple[str, ...]) -> dict[str, str]:
    """Return ID=VALUE options by id; raises UsageError for another form, or an id twice."""
    values_by_id: dict[str, str] = {}
    for text in arguments:
        name, sign, value = text.partition("=")
        if not sign or not OBJECT_ID.fullmatch(name) or not value:
            raise click.UsageError(
                f"{option} {text}: give ID=VALUE, ID of a-z, 0-9 and _, such as ot1"
            )
        if name in values_by_id:
            raise click.UsageError(f"{option} names {name} twice")
        values_by_id[name] = value
    return values_by_id


def numbers(option: str, text: str, names: str, least: int | None = None) -> list[float]:
    """Parse finite numbers with commas between them.

    Args:
        option: its name, for the message.
        text: its value.
        names: of the numbers, with commas.
        least: how many must be there, None: all.

    Raises:
        UsageError: it is something else.
    """
    most = names.count(",") + 1
    try:
        values = [decimal(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not (least or most) <= len(values) <= most or not all(map(math.isfinite, values)):
        raise click.UsageError(f"{option} {text}: give {names} as numbers")
    return values


def _rigid(text: str) -> Rigid:
    x_m, y_m, yaw_deg = numbers("--transform", text, "X,Y,YAW_DEG")
    return Rigid(x_m, y_m, math.radians(yaw_deg))


def _point(text: str) -> ReferencePoint | float:
    for word in get_args(ReferencePoint):
        if text == word:
            point: ReferencePoint = word
            return point
    try:
        ahead_m = decimal(text)
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


def accept_option() -> Option:
    """Return ``--accept NAME``, which both importers share."""
    return click.option(
        "--accept",
        "accepted",
        multiple=True,
        type=click.Choice(sorted(ACCEPTABLE)),
        metavar="NAME",
        help="Accept the findings of that name; the recording says so. Names: "
        + "; ".join(f"{name}, {what}" for name, what in sorted(ACCEPTABLE.items()))
        + ".",
    )
