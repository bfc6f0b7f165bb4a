"""What persons declare of a recording that others made, as options of both importers (METHOD 4.3).

The domain is a declaration with name, date and place. So is what only our own log would show: an
abort, an identity switch, changes on site. What nobody declares stays unknown.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Any

import click

from ssp_core.cli import Domain
from ssp_core.errors import InputError
from ssp_core.vocabulary import DomainWord
from ssp_eval.recordings.import_record import SAFE_NAME, DomainDeclaration, LogDeclaration
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
