"""Writes what documents say of tables in the code: ``python docs/generate.py``.

``state-machines.md``, ``parameters.md`` and the packages' ``config/*.param.yaml`` as a whole, and
the tables of ``MARKED`` between their marks, and the picture of an ISO 22133 object's states. A
test fails while one of them says something else than the code.
"""

from __future__ import annotations

import ast
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path

import ssp_monitor.ros.parameters
from ssp_core import names
from ssp_core.names import SESSION_COMMANDS
from ssp_core.node_interface import Parameter
from ssp_core.run_file.model import Camera, Limits, RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.safety import liveness
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.contradiction import HOLDS_S
from ssp_core.safety.publishers import Part, expected_publishers
from ssp_core.safety.stopping import stopping_of
from ssp_core.vocabulary import ControlState, ObjectClass, SessionPhase, Verdict
from ssp_eval.ros import parameters as ssp_eval_params
from ssp_ot_controller.bodies.iso22133 import states as iso
from ssp_ot_controller.bodies.iso22133.probe.clauses import CLAUSES
from ssp_ot_controller.objects import state_machine
from ssp_ot_controller.ros import parameters as ot_controller_params
from ssp_ot_controller.sil import patience
from ssp_scenario_manager.ros import parameters as scenario_manager_params
from ssp_scenario_manager.session import limits as supervisor
from ssp_scenario_manager.session import local_stops, supervision
from ssp_scenario_manager.session import state_machine as session_machine
from ssp_scenario_manager.session.limits import verdict_for
from ssp_vla_bridge.ros import parameters as vla_bridge_params

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
S = SafetyCode


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


# -- state machines -------------------------------------------------------------------------------


def _diagram(table: Mapping[Enum, Mapping[Enum, Enum]], name: Callable[[Enum], str]) -> str:
    """A Mermaid state diagram with one arrow per pair of states, under all of its events."""
    arrows: dict[tuple[Enum, Enum], list[str]] = {}
    for state, row in table.items():
        for event, target in row.items():
            arrows.setdefault((state, target), []).append(name(event))
    first = next(iter(table))
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {first.name}"]
    for (state, target), events in arrows.items():
        lines.append(f"    {state.name} --> {target.name}: {', '.join(events)}")
    return "\n".join([*lines, "```"])


def _matrix(
    table: Mapping[Enum, Mapping[Enum, Enum]], events: Sequence[Enum], name: Callable[[Enum], str]
) -> str:
    """State by event; a dash is refused, and changes nothing."""
    rows = []
    for state, row in table.items():
        cells = [row[event].name if event in row else "–" for event in events]
        rows.append([f"{state.value} {state.name}", *cells])
    return _table(["state", *(f"`{name(event)}`" for event in events)], rows)


def state_machines() -> str:
    """The whole of state-machines.md."""
    session, target = session_machine.TABLE, state_machine.TABLE
    commands = [session_machine.SessionEvent(word) for word in ("load", *SESSION_COMMANDS)]
    seen = [event for event in session_machine.SessionEvent if event not in commands]
    return f"""# State machines

Made by `python docs/generate.py` from the tables in the code; don't edit. Every pair of state and
event is tested against an expectation of its own, and an event that a state doesn't know is refused
without any effect.

## Session
`ssp_scenario_manager/session/state_machine.py`; numbers as in `SessionState.msg`. Every transition
is made, and published on `session_state`, by one function.

{_diagram(session, lambda event: str(event.value))}

Commands are services with an answer and a reason (`load` is `load_scenario`):

{_matrix(session, commands, lambda event: str(event.value))}

What the session notices itself:

{_matrix(session, seen, lambda event: str(event.value))}

`connect`, `arm`, `start` and `all_clear` are refused, with everything that is missing, unless their
conditions hold as well ([safety.md](safety.md)). `abort` is never refused.

## Object
`ssp_ot_controller/objects/state_machine.py`; names and numbers are those of ISO 22133. PRE_RUNNING
and REMOTE_CONTROLLED are states of the standard that our objects don't enter; abort is legal there
too.

{_diagram(target, lambda event: event.name)}

{_matrix(target, list(state_machine.ObjectEvent), lambda event: event.name)}

## Object that speaks ISO 22133
`ssp_ot_controller/bodies/iso22133/states.py`. What the heartbeat (HEAB) of a session says, and the
states of an object that agree with it. Those that may lead there are allowed for a while; any other
contradicts ([iso-22133.md](iso-22133.md)).

![A session's states beside a test object's](images/iso-22133-states.svg)

{_heartbeats()}

What a conforming object does; a dash changes nothing:

{_matrix(iso.AFTER, list(iso.Stimulus), lambda stimulus: str(stimulus.value))}
"""


def _heartbeats() -> str:
    rows = []
    for phase, status in iso.STATUS_OF.items():
        found: dict[iso.Fit, list[str]] = {one: [] for one in iso.Fit}
        for state in ControlState:
            found[iso.fit(phase, state)].append(state.name)
        fits = [", ".join(found[one]) or "–" for one in (iso.Fit.AGREES, iso.Fit.COMES)]
        rows.append([phase.name, f"{status.value} {status.name}", *fits])
    return _table(["session", "HEAB says", "agree", "may lead there"], rows)


# -- the picture of an ISO 22133 object's states --------------------------------------------------

# Rows of the picture: a session's states beside the object's. Arrows are those of the tables.
_P, _C = SessionPhase, ControlState
_ROWS: tuple[tuple[SessionPhase | None, ControlState], ...] = (
    (_P.LOADED, _C.INIT),
    (_P.CONNECTED, _C.DISARMED),
    (None, _C.PRE_ARMING),
    (_P.ARMED, _C.ARMED),
    (None, _C.PRE_RUNNING),
    (_P.RUNNING, _C.RUNNING),
    (_P.STOPPING, _C.POSTRUN),
    (_P.FINISHED, _C.DISARMED),
    (_P.ABORTING, _C.ABORTING),
)
_ROW_PX, _TOP_PX, _BOX_PX = 74, 84, (124, 34)
_LEFT_PX, _RIGHT_PX, _WIDTH_PX = 130, 500, 720
_INK, _MESSAGE = "#1d2733", "#1f5fa8"


def _text(x: float, y: float, words: str, color: str = _INK, more: str = "") -> str:
    return f"<text x='{x:g}' y='{y:g}' fill='{color}' {more}>{words}</text>"


def _arrow(path: str, color: str = _INK, more: str = "") -> str:
    head = "m" if color == _MESSAGE else "i"
    return f"<path d='{path}' fill='none' stroke='{color}' marker-end='url(#{head})' {more}/>"


def _column(
    x: float, rows: Sequence[Enum | None], table: Mapping[Enum, Mapping[Enum, Enum]], side: int
) -> Iterable[str]:
    """One machine: straight down to the next box, all else around it, one lane each."""
    width, height = _BOX_PX
    everywhere, lanes = _everywhere(table, rows), 0
    for begin, state in enumerate(rows):
        if state is None or state in rows[:begin]:
            continue
        arrows: dict[Enum, list[str]] = {}
        for event, target in table[state].items():
            if target in rows and target is not state and event not in everywhere:
                arrows.setdefault(target, []).append(str(event.value).replace("_", " "))
        below = next((k for k in range(begin + 1, len(rows)) if rows[k] is not None), 0)
        for target, events in arrows.items():
            words, top = ", ".join(events), _y(begin) + height / 2
            if rows[below] is target:
                yield _arrow(f"M{x},{top} V{_y(below) - height / 2 - 2}")
                anchor = "end" if side > 0 else "start"
                middle = (_y(begin) + _y(below)) / 2 + 4
                yield _text(x - side * 8, middle, words, more=f"text-anchor='{anchor}'")
                continue
            lanes += 1
            end = rows.index(target)
            edge, lane = x + side * width / 2, x + side * (width / 2 + 34 * lanes)
            # Farther lanes come in above nearer ones, so that none crosses another.
            to = _y(end) + 20 - 14 * lanes
            yield _arrow(f"M{edge},{_y(begin)} H{lane} V{to} H{edge + side * 2}")
            at, middle = lane + (12 if side > 0 else -7), (_y(begin) + to) / 2 + 10
            turn = f"transform='rotate(-90 {at:g} {middle:g})'"
            yield _text(at, middle, words, more=f"font-size='11' text-anchor='middle' {turn}")
    for k, state in enumerate(rows):
        if state is not None:
            left, top = x - width / 2, _y(k) - height / 2
            yield (
                f"<rect x='{left:g}' y='{top:g}' width='{width}' height='{height}' rx='6' "
                f"fill='#f4f7fa' stroke='{_INK}'/>"
            )
            yield _text(x, _y(k) + 4, state.name, more="text-anchor='middle' font-weight='600'")


def _y(row: int) -> int:
    return _TOP_PX + row * _ROW_PX


def _everywhere(
    table: Mapping[Enum, Mapping[Enum, Enum]], rows: Iterable[Enum | None]
) -> dict[Enum, tuple[Enum, list[str]]]:
    """Events that lead to one state from three or more: where to, and from which states not."""
    shown = [state for state in dict.fromkeys(rows) if state is not None]
    found: dict[Enum, tuple[Enum, list[str]]] = {}
    for event in {event for state in shown for event in table[state]}:
        targets = [table[state][event] for state in shown if event in table[state]]
        if len(targets) > 2 and len(set(targets)) == 1 and targets[0] in shown:
            found[event] = targets[0], [s.name for s in shown if event not in table[s]]
    return found


def _in_words(x: float, y: float, found: Mapping[Enum, tuple[Enum, list[str]]]) -> Iterable[str]:
    for k, (event, (target, but)) in enumerate(sorted(found.items(), key=lambda e: e[0].name)):
        beside = f" but {', '.join(but)}" if but else ""
        words = f"{event.value}: from every state{beside} to {target.name}"
        yield _text(x, y + 18 * k, words)


def iso_states() -> str:
    """The whole of images/iso-22133-states.svg."""
    phases, states = [phase for phase, _ in _ROWS], [state for _, state in _ROWS]
    under = _y(len(_ROWS)) - 14
    parts = [
        _text(_LEFT_PX, 34, "session", more="text-anchor='middle' font-size='15'"),
        _text(_RIGHT_PX, 34, "test object", more="text-anchor='middle' font-size='15'"),
        *_column(_LEFT_PX, phases, session_machine.TABLE, -1),
        *_column(_RIGHT_PX, states, iso.AFTER, 1),
        *_in_words(30, under, _everywhere(session_machine.TABLE, phases)),
        *_in_words(_RIGHT_PX - 130, under, _everywhere(iso.AFTER, states)),
    ]
    begin, end = _LEFT_PX + _BOX_PX[0] / 2, _RIGHT_PX - _BOX_PX[0] / 2 - 3
    for k, (phase, state) in enumerate(_ROWS):
        if phase is None:
            continue
        if iso.fit(phase, state) is not iso.Fit.AGREES:
            raise ValueError(f"{state.name} doesn't agree with {phase.name}")
        words = f"HEAB {iso.STATUS_OF[phase].name.lower().replace('_', ' ')}"
        parts.append(_arrow(f"M{begin:g},{_y(k)} H{end:g}", _MESSAGE))
        parts.append(_text(begin + 10, _y(k) - 6, words, _MESSAGE))
    heads = "".join(
        f"<marker id='{name}' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='7' "
        f"markerHeight='7' orient='auto'><path d='M0,0 L8,4 L0,8 z' fill='{color}'/></marker>"
        for name, color in (("i", _INK), ("m", _MESSAGE))
    )
    size = f"width='{_WIDTH_PX}' height='{under + 40}'"
    return "\n".join(
        [
            f"<svg xmlns='http://www.w3.org/2000/svg' {size} role='img' font-size='12' "
            "font-family='Inter, Segoe UI, Helvetica, Arial, sans-serif'>",
            f"<title>States of a session and of a test object</title><defs>{heads}</defs>",
            "<rect width='100%' height='100%' fill='#ffffff'/>",
            *parts,
            "</svg>\n",
        ]
    )


# -- limits ---------------------------------------------------------------------------------------

OBJECT, MANAGER, WORLD, RECORDER, PERSON = "object", "manager", "world", "recorder", "a person"
BOTH = (OBJECT, MANAGER)
# The limit of each event (a field of the site's limits, or words), and who judges it. A test
# compares object and manager with what the code of both judges.
JUDGED: dict[SafetyCode, tuple[str, tuple[str, ...]]] = {
    S.HEARTBEAT_LOST: ("heartbeat_s", (OBJECT,)),
    S.STATE_STALE: ("state_age_s", (OBJECT,)),
    S.STATE_NOT_FINITE: ("finite", (OBJECT, MANAGER)),
    S.OUTSIDE_GEOFENCE: ("the site's fence", (OBJECT, MANAGER)),
    S.OVER_SPEED: ("speed_mps", (OBJECT, MANAGER)),
    S.OVER_ACCELERATION: ("acceleration_mps2", (OBJECT, MANAGER)),
    S.ERROR_LONGITUDINAL: ("error_longitudinal_m", (OBJECT, MANAGER)),
    S.ERROR_LATERAL: ("error_lateral_m", (OBJECT, MANAGER)),
    S.ERROR_YAW: ("error_yaw_rad", (OBJECT, MANAGER)),
    S.LOCALISATION: ("position_std_m", (OBJECT, MANAGER)),
    S.POSITION_JUMP: ("jump_m", (OBJECT, MANAGER)),
    S.STATE_FROZEN: ("frozen_s", (OBJECT, MANAGER)),
    S.STOPPING_ROOM: ("the site's fence", (OBJECT,)),
    S.SEPARATION: ("separation_m", (OBJECT, MANAGER)),
    S.COLLISION: ("0", (OBJECT, MANAGER)),
    S.OBJECT_SILENT: ("state_age_s", (MANAGER,)),
    S.VUT_SILENT: ("state_age_s", (MANAGER,)),
    S.WORLD_SILENT: ("see below", (MANAGER,)),
    S.ACK_MISSING: ("ack_s", (MANAGER,)),
    S.REFERENCE_REFUSED: ("none refused", (OBJECT, MANAGER)),
    S.OBJECT_ABORTED: ("none", (MANAGER,)),
    S.DURATION: ("duration_s", (OBJECT, MANAGER)),
    S.RECORDER: ("none lost; see below", (MANAGER, RECORDER)),
    S.OPERATOR: ("–", (PERSON,)),
    S.PARTICIPANT_LOST: ("see below", (MANAGER, WORLD)),
    S.OVERRUN: ("see below", (MANAGER, WORLD)),
    S.EVENT_MISSING: ("end.at_latest_s", (MANAGER,)),
    S.CLOCK_OFFSET: ("clock_offset_s", (OBJECT, MANAGER)),
    S.LINK_DELAY: ("link_delay_s", (MANAGER,)),
    S.REPLY_MISSING: ("heartbeat_s", (MANAGER,)),
    S.FOREIGN_MANAGER: ("none", (OBJECT, MANAGER)),
    S.NOT_STOPPING: ("stop_reaction_s", (OBJECT,)),
    S.OBJECT_CONTRADICTS: ("[contradictions](iso-22133.md)", (OBJECT,)),
    S.CONNECTION_LOST: ("none", (OBJECT,)),
    S.STATE_CONTRADICTS: (f"[on end](#states-that-contradict-themselves) for {HOLDS_S:g} s", BOTH),
}


def _limit(words: str, unit: str) -> str:
    field = Limits.model_fields.get(words)
    if field is None:
        return words
    shown = "given by the site" if field.is_required() else f"{field.default:g} {unit}".strip()
    return f"`limits.{words}`: {shown}"


def _reaction(judges: Sequence[str]) -> str:
    if judges == (OBJECT,):
        return "local stop, which aborts the session"
    return "local stop; abort" if OBJECT in judges else "abort"


def limits() -> str:
    """Every safety event."""
    rows = []
    for code, (words, judges) in JUDGED.items():
        meaning = MEANINGS[code]
        rows.append(
            [
                str(int(code)),
                f"`{meaning.limit_name}`",
                meaning.text,
                _limit(words, meaning.unit),
                ", ".join(judges),
                _reaction(judges),
                f"`{verdict_for(code).name.lower()}`",
            ]
        )
    return _table(["code", "event", "says", "limit", "judged by", "reaction", "verdict"], rows)


def verdicts() -> str:
    """Tabulate the events that lead to each verdict."""
    rows = []
    for verdict in (
        Verdict.FAILED_SAFETY,
        Verdict.ABORTED,
        Verdict.OFF_SPEC,
        Verdict.INVALID_HARNESS,
    ):
        codes = [f"`{MEANINGS[c].limit_name}`" for c in SafetyCode if verdict_for(c) is verdict]
        rows.append([f"`{verdict.name.lower()}`", ", ".join(codes)])
    return _table(["verdict", "when the first reason is"], rows)


# -- times ----------------------------------------------------------------------------------------


def _constant(file: str, name: str) -> float:
    """A number that a module assigns, without importing it: a node's needs ROS."""
    tree = ast.parse((ROOT / file).read_text())
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(
            isinstance(target, ast.Name) and target.id == name for target in node.targets
        ):
            return float(ast.literal_eval(node.value))
    raise ValueError(f"{file} assigns no {name}")


def times() -> str:
    """Times that are the same at every site."""
    target = "ssp_ot_controller/ssp_ot_controller/objects/pool.py"
    world = "ssp_ot_controller/ssp_ot_controller/ros/sil_world.py"
    body = "ssp_ot_controller/ssp_ot_controller/sil/world.py"
    manager = "ssp_scenario_manager/ssp_scenario_manager/ros/manager_node.py"
    follow = "ssp_scenario_manager/ssp_scenario_manager/run/follow.py"
    rows = [
        ("manager", "beats outside lockstep every", _constant(manager, "WATCHDOG_PERIOD_S")),
        ("manager", "takes the recorder for silent after", liveness.RECORDER_SILENT_S),
        ("manager", "takes the camera for lost outside lockstep after", liveness.CAMERA_SILENT_S),
        (
            "manager",
            "takes a world or a camera for dead in lockstep after",
            liveness.WORLD_SILENT_LOCKSTEP_S,
        ),
        (
            "manager",
            "takes world, VUT or object for silent otherwise, by arrival, after",
            liveness.WORLD_SILENT_REALTIME_S,
        ),
        ("manager", "gives objects to report that they are armed", supervision.ARM_CONFIRMATION_S),
        ("manager", "gives an object that stops to say why", local_stops.OWN_REASON_S),
        ("manager", "blames nobody but itself after a pause of its own of", supervisor.LATE_S),
        ("manager", "reports an abort without a standstill after", supervision.ABORT_STANDSTILL_S),
        ("runner", "takes the manager for hung after", _constant(follow, "SILENT_S")),
        ("runner", "ends an aborted run without a result after", _constant(follow, "RESULT_S")),
        ("object", "stops without ticks or readings after", _constant(target, "TICK_SILENCE_S")),
        ("object", "gives a lockstep world for a step", _constant(target, "WORLD_HANG_S")),
        ("world", "drops a participant in lockstep after", patience.HANG_LIMIT_S),
        (
            "world",
            "drops a participant that a busy machine may keep waiting, and the camera, after",
            patience.BUSY_LIMIT_S,
        ),
        ("world", "says that it fell behind in realtime after", _constant(world, "OVERRUN_S")),
        (
            "simulated body",
            "brakes hard without a command after",
            _constant(body, "BODY_TIMEOUT_S"),
        ),
    ]
    return _table(["who", "does", "time"], ([a, b, f"{c:g} s"] for a, b, c in rows))


SPEEDS_MPS = (3.0, 5.0, 8.0, 10.0, 14.0, 16.0, 20.0, 25.0)
TIMEOUTS_S = (0.2, 0.5, 1.0)


def blind() -> str:
    """Tabulate how far an object drives before it knows that its link is cut."""
    rows = []
    for speed in SPEEDS_MPS:
        cells = [f"{speed * timeout:.1f} m" for timeout in TIMEOUTS_S]
        rows.append([f"{speed:g} m/s ({3.6 * speed:.0f} km/h)", *cells])
    return _table(["speed", *(f"`heartbeat_s` {t:g} s" for t in TIMEOUTS_S)], rows)


STEP_S = 0.02


def stopping() -> str:
    """The bound of the whole way from a cut link to standstill, by class."""
    site = Limits(speed_mps=20.0, acceleration_mps2=5.0)
    classes = [ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.CYCLIST, ObjectClass.PEDESTRIAN]
    rows = []
    for cls in classes:
        way = stopping_of(cls, site, STEP_S)
        cells = [
            " / ".join(
                f"{way.distance_m(v, site.heartbeat_s, gain):.1f} m"
                for gain in (0.0, site.acceleration_mps2)
            )
            for v in (2.0, 5.0, 10.0, 14.0, 16.0)
        ]
        facts = [f"{way.reaction_s:.2f} s", f"{way.deceleration_mps2:g} m/s²"]
        rows.append([cls.name.lower(), *facts, *cells])
    head = ["class", "reaction", "deceleration", "2 m/s", "5 m/s", "10 m/s", "14 m/s", "16 m/s"]
    return _table(head, rows)


def probe_clauses() -> str:
    """Tabulate what a probe of a test object expects, and the largest value that passes."""
    rows = [
        [f"`{one.id}`", one.title, "" if one.bound is None else f"{one.bound:g} {one.unit}"]
        for one in CLAUSES
    ]
    return _table(["clause", "expected", "at most"], rows)


PARTS = {
    Part.MANAGER: "manager",
    Part.WORLD: "world",
    Part.OBJECTS: "each process of objects",
    Part.RECORDER: "recorder",
    Part.CAMERA: "camera",
    Part.RUNNER: "`ssp run`",
}


def publishers() -> str:
    """Tabulate the publishers of a session, and the nodes that notice another one."""
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    target = ParticipantSpec(id="object", object_class="car", start=start)
    rows = []
    for topic, parts in expected_publishers(
        RunSpec.model_construct(targets=[target], faults=[], mode="live", camera=Camera())
    ).items():
        seen = ["manager", "recorder"] if not parts else ["manager"]
        if topic == names.HEARTBEAT:
            seen.append("objects")
        shown = re.sub(rf"\b{target.id}\b", "OBJECT", topic)
        who = ", ".join(PARTS[part] for part in parts) or "one"
        rows.append((f"`{shown}`", who, ", ".join(seen)))
    return _table(("topic", "publishers", "watched by"), rows)


BLOCKS: dict[str, Callable[[], str]] = {
    "limits": limits,
    "verdicts": verdicts,
    "times": times,
    "blind": blind,
    "stopping": stopping,
    "publishers": publishers,
    "probe_clauses": probe_clauses,
}
MARKED = ("safety.md", "iso-probe.md")
_MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_tables(text: str) -> str:
    """A document with its marked tables made anew. Raises KeyError for an unknown table."""
    return _MARKED.sub(lambda m: f"{m[1]}{BLOCKS[m[2]]()}\n{m[3]}", text)


# -- parameters -----------------------------------------------------------------------------------


PARAMETERS = {
    "ssp_scenario_manager": scenario_manager_params.NODES,
    "ssp_ot_controller": ot_controller_params.NODES,
    "ssp_monitor": ssp_monitor.ros.parameters.NODES,
    "ssp_vla_bridge": vla_bridge_params.NODES,
    "ssp_eval": ssp_eval_params.NODES,
}


def _yaml(value: object) -> str:
    return json.dumps(value)


def parameters() -> str:
    """The whole of parameters.md."""
    parts = [
        """# Parameters

`python docs/generate.py` makes this page from each package's `ros/parameters.py`; don't edit it.
`ros2 param describe` says the same. Nodes read parameters when they start: `ros2 param set` is
refused as read-only unless the table says *can be set*. A value of another type or out of its
range ends the node with one message. `scenario_manager` loads a run with `load_scenario` or
`run_scenario`; its parameter says which session it belongs to ([safety](safety.md#whose-session)).
"""
    ]
    for package, nodes in PARAMETERS.items():
        for node, table in nodes.items():
            rows = [
                [
                    f"`{one.name}`",
                    f"`{_yaml(one.default)}`" if one.default not in ("", [""]) else "",
                    one.constraint.replace("<", "&lt;"),
                    one.description + ("" if one.read_only else "; *can be set*"),
                ]
                for one in table
            ]
            parts.append(f"## {node}\nOf `{package}`.\n")
            parts.append(_table(["parameter", "default", "takes", "is for"], rows) + "\n")
    return "\n".join(parts)


def parameter_file(node: str, table: Iterable[Parameter]) -> str:
    """A file of defaults, with what each parameter is for."""
    # A bridge is named after its model.
    whole = "/**" if node == "vla_bridge" else f"/ssp/{node}"
    lines = [
        f"# Defaults of the node `{node}`, made by `python docs/generate.py`.",
        f"{whole}:",
        "  ros__parameters:",
    ]
    for one in table:
        words = f"{one.description} ({one.constraint})"
        lines += [f"    # {line}" for line in textwrap.wrap(words, 94, break_on_hyphens=False)]
        lines.append(f"    {one.name}: {_yaml(one.default)}")
    return "\n".join(lines) + "\n"


def parameter_files() -> dict[Path, str]:
    """Those that packages ship, by path."""
    return {
        path: parameter_file(node, table)
        for package, nodes in PARAMETERS.items()
        for node, table in nodes.items()
        if (path := ROOT / package / "config" / f"{node}.param.yaml").is_file()
    }


def main() -> None:
    """Writes all of them."""
    (DOCS / "state-machines.md").write_text(state_machines())
    (DOCS / "parameters.md").write_text(parameters())
    (DOCS / "images" / "iso-22133-states.svg").write_text(iso_states())
    for path, text in parameter_files().items():
        path.write_text(text)
    for name in MARKED:
        (DOCS / name).write_text(with_tables((DOCS / name).read_text()))


if __name__ == "__main__":
    main()
