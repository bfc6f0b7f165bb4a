"""Public names of a package, each loaded from its module when it is first asked for."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any


def public_name(package: str, places: Mapping[str, str], name: str) -> Any:
    """Return what a package offers under a name, for the package's ``__getattr__``.

    Args:
        package: name of the package.
        places: the module of each public name.
        name: the attribute that is asked for.

    Raises:
        AttributeError: it is no public name.
    """
    if name not in places:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    return getattr(importlib.import_module(places[name]), name)
