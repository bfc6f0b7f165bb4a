"""``python -P -m ssp_scenario_manager.sros2 RUN_FILE``: the SROS2 policy of a live session.

One table says which node may publish, hear, serve and call what; the policy allows nothing else.
Enclaves are those of hosts: ``/ssp/control`` (manager, recorder, VUT adapter, operator's tools),
``/ssp/objects`` (object targets) and ``/ssp/drivers`` (GNSS/INS and camera). docs/deployment.md
says how keys are made of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import click

from ssp_core import names
from ssp_core.console import report_error
from ssp_core.errors import SspError
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.run_file.participation import CAMERA, POSITIONING, body_of, declaring

CONTROL, OBJECTS, DRIVERS = "/ssp/control", "/ssp/objects", "/ssp/drivers"
_PARAMETERS = (
    *("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"),
    *("set_parameters", "set_parameters_atomically", "get_type_description"),
)
_LIFECYCLE = (
    *("change_state", "get_state", "get_available_states", "get_available_transitions"),
    "get_transition_graph",
)


@dataclass(frozen=True, slots=True)
class Rights:
    """The rights of one node; topics and services are relative to /ssp, or absolute.

    Args:
        enclave: of its host.
        publishes: topics.
        hears: topics.
        serves: services.
        calls: services.
        executes: actions.
        starts: actions.
        own: services below the node's own name, the parameters' included.
    """

    enclave: str
    publishes: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    executes: tuple[str, ...] = ()
    starts: tuple[str, ...] = ()
    own: tuple[str, ...] = _PARAMETERS


def rights(run: RunSpec, *receiver: str) -> dict[str, Rights]:
    """List the rights by node name, for the objects of a run.

    Args:
        run: in mode live.
        receiver: topics of the VUT's GNSS/INS, relative to /ssp or absolute.
    """
    receiver = receiver or ("odometry",)
    ids = [target.id for target in run.targets]
    singles = [] if run.states_in_one else [names.state_topic(i) for i in ids]
    states = (*singles, names.OBJECT_STATES) if run.states_in_one else tuple(singles)
    references = tuple(names.reference_topic(i) for i in ids)
    acks = tuple(names.ack_topic(i) for i in ids)
    rules = tuple(names.rules_topic(i) for i in ids)
    frames = tuple(names.iso_frames_topic(i) for i in ids)
    declared = {who: names.declared_topic(who) for who in declaring(run)}
    of_objects = tuple(declared[name] for i in ids for name in (i, body_of(i)))
    services = tuple(names.command_service(i) for i in ids)
    vut = names.state_topic(run.vut.id)
    events = (names.SESSION_STATE, names.TRIGGER_EVENT, names.PHASE_EVENT, names.SAFETY_EVENT)
    camera = (names.CAMERA_IMAGE, names.CAMERA_INFO)
    # What the manager listens for in any session, so that a stray simulated world shows.
    world = (names.WORLD_TICK, names.STEP_DONE)
    commands = (*names.SESSION_COMMANDS, names.LOAD_SCENARIO)
    manager_topics = (*events, names.HEARTBEAT, names.LINK_STATUS, names.STEP_DONE)
    statuses = (names.RECORDER_STATUS, names.LOCALISATION_STATUS, names.BODY_STATUS)
    replies = (names.HEARTBEAT_REPLY, *statuses)
    recorded = (
        *(vut, *states, *references, *acks, *rules, *manager_topics, *replies, names.FAULT_EVENT),
        *declared.values(),
    )
    transforms = (names.TF, names.TF_STATIC)
    # Page and view take states as they come, also without a run file.
    watched = (*recorded, names.OBJECT_STATES)
    links = (names.HEARTBEAT, names.LINK_STATUS)
    # In a live session nobody hears an object's actuator commands and steps; it offers them still.
    told_by_objects = (
        *(names.HEARTBEAT_REPLY, names.BODY_STATUS, names.SAFETY_EVENT, names.FAULT_EVENT),
        *(names.ACTUATOR_COMMANDS, names.STEP_DONE, f"{names.OBJECT_TARGET}/transition_event"),
    )
    table = {
        names.SCENARIO_MANAGER: Rights(
            CONTROL,
            publishes=(*manager_topics, *references, *transforms),
            hears=(
                *(vut, *states, *acks, *rules, *replies, *world, *declared.values()),
                *(names.CAMERA_INFO, names.SAFETY_EVENT),
            ),
            serves=commands,
            calls=services,
            executes=(names.RUN_SCENARIO,),
        ),
        names.MONITOR: Rights(
            CONTROL, publishes=(names.RECORDER_STATUS, names.SAFETY_EVENT, names.STEP_DONE)
        ),
        f"{names.MONITOR}_intake": Rights(
            CONTROL,
            hears=(*recorded, *frames, *camera, names.CAMERA_MOUNT, *transforms),
            own=_PARAMETERS[-1:],
        ),
        names.MONITOR_PAGE: Rights(
            CONTROL,
            hears=(*watched, *camera),
            calls=names.SESSION_COMMANDS,
        ),
        "view": Rights(
            CONTROL,
            publishes=("markers/scene", "markers/objects", "/diagnostics"),
            hears=watched,
        ),
        names.VUT_ADAPTER: Rights(
            CONTROL, publishes=(vut, names.LOCALISATION_STATUS), hears=receiver
        ),
        names.RUNNER: Rights(
            CONTROL,
            hears=(
                *(*events, *states, vut, names.FAULT_EVENT, names.LINK_STATUS),
                *(*statuses, names.CAMERA_INFO, names.HEARTBEAT, *declared.values()),
            ),
            calls=(*commands,),
            starts=(names.RUN_SCENARIO,),
        ),
        "doctor_session": Rights(
            CONTROL,
            hears=(
                *(vut, *states, names.OBJECT_STATES, *rules, *frames, *replies),
                *(*camera, *receiver, *links),
            ),
        ),
        names.OBJECT_TARGET: Rights(
            OBJECTS,
            publishes=(*states, *acks, *rules, *frames, *of_objects, *told_by_objects),
            hears=(*references, names.HEARTBEAT, vut, *states),
            serves=services,
            own=(*_PARAMETERS, *_LIFECYCLE),
        ),
        "body": Rights(DRIVERS, publishes=of_objects),
        "gnss_ins": Rights(
            DRIVERS, publishes=(*receiver, declared[names.VUT_ID], declared[POSITIONING])
        ),
    }
    if run.camera is not None:
        told_by_camera = (*camera, names.CAMERA_MOUNT, declared[CAMERA])
        table["camera"] = Rights(DRIVERS, publishes=told_by_camera)
    return table


def policy(run: RunSpec, *receiver: str) -> str:
    """Return the policy as XML (SROS2 policy schema 0.2.0); arguments as for ``rights``."""
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    table = rights(run, *receiver)
    for path in sorted({right.enclave for right in table.values()}):
        enclave = ElementTree.SubElement(enclaves, "enclave", path=path)
        profiles = ElementTree.SubElement(enclave, "profiles")
        for node, right in sorted(table.items()):
            if right.enclave == path:
                profile = ElementTree.SubElement(profiles, "profile", ns="/ssp", node=node)
                _fill(profile, node, right)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _fill(profile: ElementTree.Element, node: str, right: Rights) -> None:
    # Every node logs and tells of its parameters.
    publishes = (*right.publishes, "/rosout", "/parameter_events")
    own = tuple(f"{node}/{service}" for service in right.own)
    _group(profile, "actions", "execute", right.executes)
    _group(profile, "actions", "call", right.starts)
    _group(profile, "services", "reply", (*right.serves, *own))
    _group(profile, "services", "request", right.calls)
    _group(profile, "topics", "publish", publishes)
    _group(profile, "topics", "subscribe", right.hears)


def _group(
    profile: ElementTree.Element, kind: str, what: str, resource_names: Iterable[str]
) -> None:
    absolute_names = sorted({names.absolute(name) for name in resource_names})
    if absolute_names:
        group = ElementTree.SubElement(profile, kind, {what: "ALLOW"})
        for name in absolute_names:
            ElementTree.SubElement(group, kind.removesuffix("s")).text = name


@click.command()
@click.argument("run_file", type=click.Path(path_type=Path))
@click.option(
    *("--odometry", "--navsat", "--heading", "--velocity", "receiver"),
    multiple=True,
    default=["odometry"],
    help="Topics of the VUT's GNSS/INS.",
)
def main(run_file: Path, receiver: tuple[str, ...]) -> None:
    """Print the SROS2 policy of the live session RUN_FILE."""
    try:
        click.echo(policy(load_run(run_file), *receiver), nl=False)
    except SspError as error:
        report_error(str(error))
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
