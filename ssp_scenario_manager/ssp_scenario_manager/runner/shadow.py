"""Models that follow a session in shadow mode: no part of it, and no reason for it to fail."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ssp_core.errors import InputError
from ssp_core.processes import NodeProcess, ProcessGroup

MODULE = "ssp_vla_bridge.node"
DEFAULT_HZ = 2.0
# What the recorder is to take besides, so that the answers are in the bag.
RECORDED = "^/diagnostics$|^/ssp/vla/[^/]+/response$"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_OWN = ("backend", "interface", "timeout_s", "hz")


@dataclass(frozen=True)
class ShadowModel:
    """One model that follows the session.

    Args:
        name: on the topics.
        parameters: of its bridge.
    """

    name: str
    parameters: dict[str, object] = field(default_factory=dict)


def shadow_model(text: str) -> ShadowModel:
    """The model of ``NAME`` or ``NAME={"backend": …, "hz": …, further options}``.

    Raises:
        InputError: it is no such text.
    """
    name, _, given = text.partition("=")
    if not _NAME.fullmatch(name):
        raise InputError(
            "is no name for a topic",
            field="--shadow",
            value=name,
            remedy="use letters, digits and underscores, a letter first",
        )
    try:
        options: Any = json.loads(given) if given.strip() else {}
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not valid JSON: {error}", field="--shadow", value=given) from error
    if not isinstance(options, dict):
        raise InputError("must be a JSON object", field="--shadow", value=given)
    hz = options.get("hz", DEFAULT_HZ)
    if isinstance(hz, bool) or not isinstance(hz, int | float) or not 0.0 < hz <= 100.0:
        raise InputError("must lie in (0, 100] Hz", field="--shadow hz", value=hz)
    parameters: dict[str, object] = {"model": name, "shadow_hz": float(hz)}
    for key in ("backend", "interface"):
        if key in options:
            parameters[key] = str(options[key])
    if "timeout_s" in options:
        parameters["timeout_s"] = _seconds(options["timeout_s"])
    backend_options = {key: value for key, value in options.items() if key not in _OWN}
    if backend_options:
        # Parameter values are read as YAML; the quoted text stays one string.
        parameters["backend_options"] = json.dumps(json.dumps(backend_options))
    return ShadowModel(name, parameters)


def _seconds(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError("must be seconds", field="--shadow timeout_s", value=value)
    return float(value)


@contextmanager
def shadows_beside(
    session: ProcessGroup,
    models: Sequence[ShadowModel],
    say: Callable[[str], None],
    remappings: Sequence[str] = (),
) -> Iterator[None]:
    """Has the models follow as long as the block runs; their processes are none of the session's.

    Args:
        session: whose domain and log folder they share.
        models: which; none starts nothing.
        say: takes one line for people per thing that happens.
        remappings: ``from:=to``, as the session's own nodes have them.
    """
    if not models:
        yield
        return
    # The session's group alone may remove what is left of the domain.
    with ProcessGroup(session.env, session.log_dir, owns_domain=False) as group:
        watches = []
        for model in models:
            name = f"vla_bridge_{model.name}"
            node = group.start_node(name, MODULE, model.parameters, remappings)
            watches.append(threading.Thread(target=_watch, args=(model, node, say), daemon=True))
            watches[-1].start()
        try:
            yield
        finally:
            group.stop()
            for watch in watches:
                watch.join()


def _watch(model: ShadowModel, node: NodeProcess, say: Callable[[str], None]) -> None:
    """Says that a model has ended, should it."""
    node.process.wait()
    if not node.expected_to_stop:
        tail = node.log_tail(3)
        say(
            f"the bridge of {model.name} {node.describe_exit()}; the session goes on without it"
            + (f": {tail}" if tail else "")
        )
