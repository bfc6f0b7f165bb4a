"""The words in which a backend asks a request, told without asking it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_vla_bridge.core.backend import SERVICES, interface_of
from ssp_vla_bridge.core.prompts import PROMPTS
from ssp_vla_bridge.core.request import Request

# Asks all steps of its interface itself; services are given the words of a single step.
_ASKS_STEPS = "openai"


def native_prompt(interface: str, request: Request) -> str | None:
    """What an interface asks in words, where it asks in one step; None where it doesn't.

    Raises:
        InputError: it can't ask what the task asks.
    """
    stages = PROMPTS.get(interface, ())
    if len(stages) != 1:
        return None
    prompt = stages[0].build(request, {})
    return f"{prompt.system}\n\n{prompt.text}" if prompt.system else prompt.text


def words_sha256(backend: str, options: Mapping[str, Any], request: Request) -> str | None:
    """Hash of all the words in which a backend of ours asks a request; None: it uses none.

    What the model itself says in a step is left open in the steps behind it: it follows from the
    words before.

    Args:
        backend: its name.
        options: of the backend.
        request: what is asked.

    Raises:
        InputError: the options name no interface.
    """
    interface = interface_of(backend, options)
    if backend != _ASKS_STEPS and backend not in SERVICES:
        return None
    try:
        if backend in SERVICES:
            words = native_prompt(interface, request)
            return None if words is None else sha256_json(words)
        stages = PROMPTS.get(interface, ())
        left_open = {stage.name: f"({stage.name})" for stage in stages}
        return sha256_json([[s.name, s.build(request, left_open).sha256] for s in stages])
    except InputError as error:  # the answer will be this error
        return sha256_json(str(error))
