"""The models of ``ssp evaluate`` as drivers: one way to name a model, whatever it is to do.

Its functions are those that ssp_core.world.driver asks Provider.MODELS for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.reading import read_mapping
from ssp_core.world.driver import RecordedAnswer, SeeingDriver
from ssp_eval.evaluate.clients.models import (
    CONTROLS,
    ModelSpec,
    beside_options,
    check_bridge,
    entry_spec,
    load_models,
)
from ssp_vla_bridge.backend import BACKENDS
from ssp_vla_bridge.driving.driver import BridgeDriver, DriverModel, prompt_facts
from ssp_vla_bridge.egodriver.options import HISTORY_S as EGODRIVER_HISTORY_S
from ssp_vla_bridge.egodriver.options import read_options

# The entry of a models file, in the options of a driver.
MODEL = "model"
# The key of an entry by which a driver is given the centre line, and the backends that hand it on.
CENTRE_LINE = "centre_line"
# The key of an entry whose bridge's node was started by somebody else.
ATTACHED = "attached"
_TAKE_CENTRE_LINE = ("python", "http")
# A policy behind AlpaSim's EgodriverService: what the options of a driver hold instead, and its
# backend's name. It keeps a session with its server, so that it is no backend of open loop.
EGODRIVER = "egodriver"
# Keys of an entry that say nothing of how such a policy is asked.
_FACTS = {"total_b", "active_b", "architecture", "weights_sha256"}


def driver_options(
    name: str, arguments: Mapping[str, Any], models_file: Path | None, others: Sequence[str]
) -> dict[str, Any]:
    """Return the options of a model as a run file keeps them: its entry of a models file.

    Args:
        name: of a model of the models file, or of a bridge.
        arguments: what stands behind ``NAME=``, as with ``ssp evaluate --bridge``.
        models_file: of ssp.models/1; None: none is given.
        others: names of drivers that are no models, for the message.

    Raises:
        InputError: there is no such model or bridge, or it may not drive.
    """
    if set(arguments) == {EGODRIVER} and isinstance(arguments[EGODRIVER], dict):
        return _policy_options(name, {"options": arguments[EGODRIVER]})
    if set(arguments) == {MODEL} and isinstance(arguments[MODEL], dict):
        entry = dict(arguments[MODEL])
    elif models_file is not None and not arguments:
        entry = _entry(name, models_file)
    else:
        entry = beside_options(arguments)
        if ATTACHED in arguments:
            raise _attached(name)
    spec = entry_spec(name, entry)
    if spec.backend_name == EGODRIVER:
        return _policy_options(name, entry)
    if spec.attached:
        raise _attached(name)
    if CONTROLS.get(spec.backend_name):
        raise InputError(
            "answers from labels, and a driver gets none",
            field=f"driver {name}",
            value=spec.backend_name,
            remedy="give the backend of a model",
        )
    if spec.backend_name not in BACKENDS and ":" not in spec.backend_name:
        raise InputError(
            "is no driver" if spec.backend_name == name else "is no backend of a driver",
            field="driver" if spec.backend_name == name else f"driver {name}",
            value=spec.backend_name,
            remedy=f"there is {', '.join(others)}; a model of yours is named as with ssp evaluate, "
            'NAME={"backend": …}, with one of the backends ' + ", ".join(sorted(BACKENDS)),
        )
    if entry.get(CENTRE_LINE) and not _takes_centre_line(spec.backend_name):
        raise InputError(
            "has no place for the centre line of its lane in what its model gets",
            field=f"driver {name}.{CENTRE_LINE}",
            value=spec.backend_name,
            remedy=f"leave {CENTRE_LINE} out, or use {', '.join(_TAKE_CENTRE_LINE)} or a backend "
            "of your own",
        )
    check_bridge(spec)
    return {MODEL: entry}


def _attached(name: str) -> InputError:
    """Return the refusal of a bridge's node that runs already, without its domain.

    A session has a domain of its own, so that its driver hears nothing else of it (METHOD 8.2).
    """
    return InputError(
        "doesn't say in which domain the bridge's node is already running",
        field=f"driver {name}.{ATTACHED}",
        value=True,
        remedy='give NAME={"backend": "node", "topic": …, "domain_id": …}, with the parameter '
        "`model` and the ROS_DOMAIN_ID of the node; or end it, and give its own backend, which "
        "each run then loads anew",
    )


def _takes_centre_line(backend: str) -> bool:
    """Tell whether a backend hands a whole request to its model."""
    return backend in _TAKE_CENTRE_LINE or ":" in backend


def _policy_options(name: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a policy behind an EgodriverService, all of them."""
    for key in sorted(set(entry) - {"backend", "options"} - _FACTS):
        raise InputError(
            "says nothing to a policy behind an EgodriverService",
            field=f"driver {name}.{key}",
            remedy="its time limit is deadline_s; leave the rest out",
        )
    return {EGODRIVER: read_options(dict(entry.get("options") or {}), name).model_dump()}


def _entry(name: str, models_file: Path) -> dict[str, Any]:
    names = [spec.name for spec in load_models(models_file)]
    if name not in names:
        raise InputError(
            "holds no such model",
            file=models_file,
            field="models",
            value=name,
            remedy=f"there is {', '.join(names)}",
        )
    return dict(read_mapping(models_file)["models"][name] or {})


def model_facts(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts of a model, see ssp_core.world.driver.model_facts."""
    if EGODRIVER in options:
        policy = read_options(options[EGODRIVER], name)
        return {
            "model": policy.url,
            "weights_sha256": None,
            "prompt_sha256": None,
            "prompt": "the calls of an EgodriverService hold no words",
            "interface": EGODRIVER,
            "adapter": EGODRIVER,
            # All that the camera drew since the question before.
            "frames": None,
            "frame_spacing_s": None,
            "history_s": EGODRIVER_HISTORY_S,
            "timeout_s": policy.deadline_s,
            "sees_route": True,
        }
    model, spec = bridge_model(name, options), _spec(name, options)
    model_name = spec.options.get("model")
    return {
        "model": model_name if isinstance(model_name, str) else model.backend,
        "weights_sha256": dict(options.get(MODEL, {})).get("weights_sha256"),
        **prompt_facts(model),
        "interface": model.interface.name,
        "adapter": model.adapter,
        "frames": model.rules.frames,
        "frame_spacing_s": model.rules.frame_spacing_s,
        "history_s": model.rules.history_s,
        "timeout_s": model.limit_s,
        "sees_route": model.centre_line,
    }


def make_driver(
    name: str,
    options: Mapping[str, Any],
    recorded: Sequence[RecordedAnswer] | None = None,
    is_wanted: Callable[[], bool] = lambda: True,
) -> SeeingDriver:
    """Return a fresh driver, see ssp_core.world.driver.make_driver."""
    if EGODRIVER in options:
        # gRPC is loaded where it is used.
        from ssp_vla_bridge.egodriver.client import EgodriverDriver

        return EgodriverDriver(name, read_options(options[EGODRIVER], name), recorded, is_wanted)
    return BridgeDriver(bridge_model(name, options), recorded, is_wanted)


def bridge_model(name: str, options: Mapping[str, Any]) -> DriverModel:
    """Return a model as it is to drive, of what ``driver_options`` returned."""
    spec = _spec(name, options)
    return DriverModel(
        name=name,
        backend=spec.backend_name,
        options=spec.options,
        interface=spec.model_interface,
        adapter=spec.read_by(),
        rules=spec.rules,
        timeout_s=spec.timeout_s,
        centre_line=bool(options.get(MODEL, {}).get(CENTRE_LINE)),
    )


def _spec(name: str, options: Mapping[str, Any]) -> ModelSpec:
    return entry_spec(name, dict(options.get(MODEL, {})))
