"""C1: participants, roads, lanes and conflict zone stand in valid relations; ids are stable."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View, one_of
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.spec.model import IntentWord

_fail = Fail("C1")

_VUT_CLASSES = frozenset({"car", "truck", "bus"})


def one_vut(view: View) -> Iterator[Failure]:
    """Exactly one participant is the VUT."""
    vuts = [who for who, p in view.event.participants.items() if p.role == "VUT"]
    if len(vuts) == 1:
        return
    extra = [who for who in vuts if who != view.event.interaction.affected] or [
        view.event.interaction.affected
    ]
    for who in extra:
        yield _fail(
            f"participants.{who}.role",
            f"VUTs: {', '.join(vuts) or 'none'}",
            "an event has exactly one vehicle under test",
            "give one participant the role VUT and the others OT",
        )


def same_ids_everywhere(view: View) -> Iterator[Failure]:
    """Parts A, M and C speak of the same ids."""
    ids = set(view.event.participants)
    parts: dict[str, set[str]] = {
        "motion": set(view.event.motion),
        "constraints.speeds": set(view.event.constraints.speeds),
    }
    for part, found in parts.items():
        for who in sorted(ids ^ found):
            there = who in found
            yield _fail(
                f"{part}.{who}",
                f"participants: {one_of(ids)}; {part}: {one_of(found)}",
                "speaks of somebody who is no participant" if there else "lacks a participant",
                "use the participants' own ids in every part",
            )


def every_phase(view: View) -> Iterator[Failure]:
    """Parts M and C have each participant in all four phases."""
    given: dict[str, dict[str, set[str]]] = {
        "motion": {who: set(cells) for who, cells in view.event.motion.items()},
        "constraints.speeds": {k: set(v) for k, v in view.event.constraints.speeds.items()},
    }
    for part, by_id in given.items():
        for who, phases in sorted(by_id.items()):
            for phase in PHASES:
                if phase not in phases:
                    yield _fail(
                        f"{part}.{who}.{phase}",
                        f"{part}.{who} has {one_of(phases) or 'nothing'}",
                        "an id must be the same, and known, in every phase",
                        f"give {who} in all of {', '.join(PHASES)}",
                    )


def interaction_names_participants(view: View) -> Iterator[Failure]:
    """The initiator is an OT, the affected one the VUT, and they alone pass the conflict point."""
    event = view.event
    interaction = event.interaction
    roles = {who: p.role for who, p in event.participants.items()}
    for name, role in (("initiator", "OT"), ("affected", "VUT")):
        who = getattr(interaction, name)
        if roles.get(who) != role:
            yield _fail(
                f"interaction.{name}",
                view.said(f"interaction.{name}", f"participants.{who}.role"),
                f"the {name} must be a participant with role {role}",
                f"one of {one_of(k for k, v in roles.items() if v == role) or 'none'}",
            )
    both = {interaction.initiator, interaction.affected}
    if set(interaction.passing_order) != both or len(both) < 2:
        yield _fail(
            "interaction.passing_order",
            view.said("interaction.passing_order", "interaction.initiator", "interaction.affected"),
            "initiator and affected, each once, pass the conflict point",
            f"name {one_of(both)}, the first to arrive first",
        )
    if event.constraints.trigger.object != interaction.initiator:
        yield _fail(
            "constraints.trigger.object",
            view.said("constraints.trigger.object", "interaction.initiator"),
            "the trigger is measured to the OT whose manoeuvre it fires",
            interaction.initiator,
        )


def classes_fit_roles(view: View) -> Iterator[Failure]:
    """VUT and initiator are of classes that can do what they do."""
    event, kind = view.event, view.kind
    for who, participant in event.participants.items():
        path = f"participants.{who}.class"
        if participant.role == "VUT" and participant.class_ not in _VUT_CLASSES:
            yield _fail(
                path, view.said(path), "can't be a vehicle under test", one_of(_VUT_CLASSES)
            )
    who = view.initiator
    found = event.participants.get(who)
    if kind and found and found.class_ not in kind.initiator_classes:
        yield _fail(
            f"participants.{who}.class",
            view.said(f"participants.{who}.class", "interaction.type"),
            f"can't be the initiator of {kind.name}",
            one_of(kind.initiator_classes),
        )


def only_the_vut_has_an_intent(view: View) -> Iterator[Failure]:
    """The VUT says where it means to go, and nobody else does."""
    for who, participant in view.event.participants.items():
        is_vut, path = participant.role == "VUT", f"participants.{who}.intent"
        if is_vut == (participant.intent is None):
            yield _fail(
                path,
                view.said(path, f"participants.{who}.role"),
                "nobody says what the VUT is about to do (METHOD 1)"
                if is_vut
                else "the intent is the VUT's; what an OT does stands in part M",
                one_of(get_args(IntentWord)) if is_vut else "no intent",
            )


PREDICATES: tuple[Predicate, ...] = (
    one_vut,
    only_the_vut_has_an_intent,
    same_ids_everywhere,
    every_phase,
    interaction_names_participants,
    classes_fit_roles,
)
