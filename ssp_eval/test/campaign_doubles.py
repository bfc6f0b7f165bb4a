"""Ways to models that end badly, for workers to import."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from typing import Any

from ssp_core.errors import InputError
from ssp_eval.evaluate.clients.model_client import InProcessClients, ModelClient
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.extract.combined.extractor import Extractor


class Deadly(InProcessClients):
    """Kills its own process when it is asked for one model."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        if model.name == "deadly":
            os.kill(os.getpid(), signal.SIGKILL)
        return super().client(model, options)


class Wrong(InProcessClients):
    """Finds fault with an option where a cell is asked."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        raise InputError("is wrong", field="speed", value=3)


class Faulty(InProcessClients):
    """Has a bug."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        raise ZeroDivisionError("on purpose")


class _Versioned(Extractor):
    """Rules of a version that no other process has."""

    @property
    def sha256(self) -> str:
        return f"sha256:{os.getpid():064d}"


def another_each_time() -> Extractor:
    return _Versioned()
