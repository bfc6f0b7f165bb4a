"""A model that is any Python function: ``f(request)`` gives text, or text and points, or an Answer.

def drive(request):
    return "I keep my speed.", [(0.0, 0.0), (4.0, 0.0), (8.0, 0.0)]
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.adapters.points import WAYPOINTS_ARRAY, WAYPOINTS_FRAME
from ssp_vla_bridge.backend import check_options, look_here_too
from ssp_vla_bridge.messages import Answer, NativeArray, Request
from ssp_vla_bridge.window import find_interface

_KNOWN: dict[str, type] = {
    "function": str,
    "folder": str,
    "options": dict,
    "interface": str,
    "model_id": str,
    "step_s": float,
    "first_time_s": float,
}
_FIELD = "backend_options.function"
_FORMS = "give module:function or package.module.function"
# A plan has some tens of points. More than these aren't read, however many there are.
_MOST_POINTS = 1 << 17


class PythonFunction:
    """A function as a model.

    Args:
        step_s: between the points that it gives, s; None: the task's.
        first_time_s: of the first point after the request's time, s.
    """

    def __init__(
        self,
        function: Callable[[Request], Any],
        model_id: str,
        interface: str = "waypoints",
        step_s: float | None = None,
        first_time_s: float = 0.0,
    ) -> None:
        self.model_id = model_id
        self.interface = interface
        self._function = function
        self._step_s = step_s
        self._first_time_s = first_time_s

    def answer(self, request: Request) -> Answer:
        """Return the function's answer; raise PeerError where it can't be sent."""
        output = self._function(request)
        if isinstance(output, Answer):
            return output
        if isinstance(output, str):
            return Answer(output)
        if isinstance(output, tuple) and len(output) == 2 and isinstance(output[0], str):
            step_s = self._step_s or request.task.trajectory_step_s
            return Answer(output[0], (_points(output[1], step_s, self._first_time_s),))
        raise PeerError(
            f"the function gave {type(output).__name__}; it must give an Answer, a text, or a text "
            "and points (x forward, y left, in m)"
        )


def _points(points: Any, step_s: float, first_time_s: float) -> NativeArray:
    """Read rows (x, y) of anything iterable: lists, numpy arrays, tensors."""
    try:
        rows = [tuple(float(value) for value in row) for row in islice(points, _MOST_POINTS + 1)]
    except (TypeError, ValueError, OverflowError) as error:
        raise PeerError(f"the function's points are no rows of two numbers: {error}") from error
    if len(rows) > _MOST_POINTS:
        raise PeerError(f"the function gives more than {_MOST_POINTS} points")
    wrong = next((i for i, row in enumerate(rows) if len(row) != 2), None)
    if wrong is not None:
        raise PeerError(
            f"the function's point {wrong} has {len(rows[wrong])} numbers; a point is (x, y)"
        )
    return NativeArray(
        name=WAYPOINTS_ARRAY,
        shape=(len(rows), 2),
        data=tuple(value for row in rows for value in row),
        frame=WAYPOINTS_FRAME,
        unit="m",
        step_s=step_s,
        first_time_s=first_time_s,
    )


def make(options: Mapping[str, Any]) -> PythonFunction:
    """Make a backend of the function that the option ``function`` names.

    Further options: ``folder`` to look for its module in before all others (the working folder is
    the last of them), ``options`` for the function's own keyword ``options``, ``interface``
    (default waypoints), ``model_id``, and for points ``step_s`` (default: the task's) and
    ``first_time_s`` (default 0).

    Raises:
        InputError: the options are wrong, or the function isn't there.
    """
    check(options)
    path = str(options["function"])
    step_s = float(options["step_s"]) if "step_s" in options else None
    if "folder" in options:
        _look_in(str(options["folder"]))
    look_here_too()
    function = _function(path)
    return PythonFunction(
        _with_options(function, path, options.get("options")),
        str(options.get("model_id", f"python({path})")),
        find_interface(str(options.get("interface", "waypoints"))).name,
        step_s,
        float(options.get("first_time_s", 0.0)),
    )


def check(options: Mapping[str, Any]) -> None:
    """Refuse what can be seen without importing the function's module, which may load a model.

    Raises:
        InputError: an option is unknown or has a wrong value, or the function's name is none.
    """
    check_options("python", options, _KNOWN)
    path = str(options.get("function", ""))
    if not path:
        raise InputError("is missing", field=_FIELD, remedy=_FORMS)
    if not all(split(path)):
        raise InputError("names no function", field=_FIELD, value=path, remedy=_FORMS)
    if "step_s" in options and not 0.001 <= options["step_s"] <= 60.0:
        raise InputError(
            "must lie in [0.001, 60] s",
            field="backend_options.step_s",
            value=options["step_s"],
            remedy="give a time of that range",
        )


def split(path: str) -> tuple[str, str]:
    """Split ``module:function`` or ``module.function``; a missing part is empty."""
    module, separator, name = path.partition(":")
    if not separator:
        module, _, name = path.rpartition(".")
    return module, name


def _look_in(folder: str) -> None:
    if not Path(folder).is_dir():
        raise InputError(
            "is no folder",
            field="backend_options.folder",
            value=folder,
            remedy="name the folder that the module lies in",
        )
    place = str(Path(folder).resolve())
    if place not in sys.path:
        sys.path.insert(0, place)


def _function(path: str) -> Callable[..., Any]:
    module_name, name = split(path)
    try:
        target: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise _broken(module_name, path, error) from error
        raise InputError(
            f"can't be found: there is no module {error.name}",
            field=_FIELD,
            value=path,
            remedy="name the folder that holds it with the option folder, or put it on PYTHONPATH",
        ) from error
    except (Exception, SystemExit) as error:  # a module runs whatever its author wrote
        raise _broken(module_name, path, error) from error
    for part in name.split("."):
        if not hasattr(target, part):
            raise InputError(
                f"can't be found: {getattr(target, '__file__', module_name)} has no {part}",
                field=_FIELD,
                value=path,
                remedy=_FORMS,
            )
        target = getattr(target, part)
    if not callable(target):
        raise InputError(
            f"is a {type(target).__name__}, no function", field=_FIELD, value=path, remedy=_FORMS
        )
    checked: Callable[..., Any] = target
    return checked


def _broken(module_name: str, path: str, error: BaseException) -> InputError:
    """Describe a module that is there and can't be imported."""
    spec = None
    try:
        spec = importlib.util.find_spec(module_name)
    except Exception:  # its parent may be what is broken
        spec = None
    where = spec.origin if spec is not None and spec.origin else module_name
    return InputError(
        f"can't be imported: {where} raises {type(error).__name__}: {error}",
        field=_FIELD,
        value=path,
        remedy="make the module importable, for example by installing what it needs",
    )


def _with_options(
    function: Callable[..., Any], path: str, options: Any
) -> Callable[[Request], Any]:
    try:
        parameters = inspect.signature(function).parameters
    except (TypeError, ValueError):  # some built-in callables tell none
        parameters = {}  # type: ignore[assignment]
    takes = "options" in parameters or any(
        p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values()
    )
    if takes:
        function_options = dict(options or {})
        return lambda request: function(request, options=function_options)
    if options:
        raise InputError(
            f"are given, but {path} takes no keyword named options",
            field="backend_options.options",
            remedy="leave them out, or let the function take options",
        )
    return function
