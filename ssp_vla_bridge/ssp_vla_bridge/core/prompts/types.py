"""What a prompt is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ssp_core.hashing import sha256_json
from ssp_vla_bridge.core.request import Request


@dataclass(frozen=True)
class Prompt:
    """The words of one question; the frames go before the text.

    Args:
        text: of the user's message.
        system: of the system's message, empty where there is none.
    """

    text: str
    system: str = ""

    @property
    def sha256(self) -> str:
        return sha256_json({"system": self.system, "text": self.text})


@dataclass(frozen=True)
class Stage:
    """One step of an answer.

    Args:
        name: ``scene``, ``objects``, ``intent`` or ``motion``.
        build: the prompt, from the request and the raw texts of the steps before, by name.
            It raises InputError where the interface can't give what the task asks for.
    """

    name: str
    build: Callable[[Request, Mapping[str, str]], Prompt]
