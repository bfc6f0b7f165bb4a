"""Which K* the labels of a recording go by: its thresholds, what is observable, its window."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping, parse_model
from ssp_core.motion.encounter import Observable
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.recordings.crop import Window
from ssp_eval.recordings.event_rules import event_observable, event_thresholds, window_of
from ssp_eval.recordings.provenance import Provenance
from ssp_scenario_manager.compile.task import EVENT_FILE
from ssp_scenario_manager.event_spec.load import event_version, load_event
from ssp_scenario_manager.event_spec.model import Event

# A labels file must name a version; this one says that nobody knows it.
UNKNOWN_VERSION = "unknown"


@dataclass(frozen=True)
class KStar:
    """A K*, its version, and how it was found, for people."""

    event: Event
    version: str
    said_by: str


@dataclass(frozen=True)
class EventRules:
    """What labels take from a K*, or from the run; None: nobody says.

    Args:
        thresholds: of the conflict.
        observable: what makes the manoeuvre observable.
        window: of the source's crop (METHOD 4.1).
        said_by: who says so, for people.
    """

    thresholds: ConflictThresholds | None
    observable: Observable | None
    window: Window | None
    said_by: str


def given_event(name_or_path: str) -> KStar:
    """The K* that a user names.

    Raises:
        InputError: see load_event.
    """
    event, version = load_event(name_or_path)
    return KStar(event, version, f"K* {event.name}")


def attached_event(bag: BagReader) -> KStar | None:
    """The K* in a bag, None: it holds none.

    Raises:
        InputError: it isn't valid.
    """
    data = bag.attachment(EVENT_FILE)
    if data is None:
        return None
    place = f"{bag.path}:{EVENT_FILE}"
    event = parse_model(Event, parse_mapping(data, place), place)
    return KStar(event, event_version(event), f"the K* {event.name} in the recording")


def shipped_event(scenario: str | None, version: str | None) -> KStar | None:
    """The shipped K* of a scenario, None: there is none, or not of this version.

    Args:
        scenario: name.
        version: that it must have; None or UNKNOWN_VERSION: any.
    """
    if scenario is None:
        return None
    try:
        event, found = load_event(scenario)
    except InputError:
        return None
    if version not in (found, None, UNKNOWN_VERSION):
        return None
    return KStar(event, found, f"the shipped K* {event.name}")


def rules_of(
    k_star: KStar | None, provenance: Provenance | None, scenario: str | None, version: str | None
) -> EventRules:
    """The rules for a recording: the K*'s, else the run's, else none.

    Args:
        k_star: that was given or lies in the bag.
        provenance: of the bag; None: it is a clip's truth file.
        scenario: name.
        version: K* version that the recording or the user names.
    """
    run = None if provenance is None else provenance.run
    found = k_star or shipped_event(scenario, version)
    if found is not None:
        event = found.event
        observable = event_observable(event) or (None if run is None else run.observable)
        return EventRules(event_thresholds(event), observable, window_of(event), found.said_by)
    if run is not None:
        return EventRules(run.thresholds, run.observable, None, "the recorded run")
    why = f"none is shipped for {scenario}"
    if scenario is not None and shipped_event(scenario, None) is not None:
        why = f"the shipped {scenario} is not {version}"
    return EventRules(None, None, None, f"no K*, the defaults: {why}")
