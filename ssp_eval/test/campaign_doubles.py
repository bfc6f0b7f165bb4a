"""Ways to models that end badly, for workers to import."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from typing import Any

from ssp_core.errors import InputError
from ssp_eval.evaluate.asker import Asker, DirectAskers
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.extract.llm import Extractor


class Deadly(DirectAskers):
    """Kills its own process when it is asked for one model."""

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        if model.name == "deadly":
            os.kill(os.getpid(), signal.SIGKILL)
        return super().asker(model, options)


class Wrong(DirectAskers):
    """Finds fault with an option where a cell is asked."""

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        raise InputError("is wrong", field="speed", value=3)


class Faulty(DirectAskers):
    """Has a bug."""

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        raise ZeroDivisionError("on purpose")


class _Versioned(Extractor):
    """Rules of a version that no other process has."""

    @property
    def sha256(self) -> str:
        return f"sha256:{os.getpid():064d}"


def another_each_time() -> Extractor:
    return _Versioned()
