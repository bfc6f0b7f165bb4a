"""A model of a campaign: who it is, how it is asked, and how its answers are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ssp_eval.evaluate.controls import CLIP_START_NS, LABELS_FILE
from ssp_vla_bridge.adapters.registry import check_adapter
from ssp_vla_bridge.backend import interface_of
from ssp_vla_bridge.window import Interface, Preprocessing, find_interface


@dataclass(frozen=True)
class ModelFacts:
    """What reports say of a model; nothing here changes how it is asked or scored.

    Args:
        total_b: parameters, billions; None where nobody says.
        active_b: parameters that one token uses, billions; None where nobody says.
        architecture: a word such as ``dense`` or ``moe``; empty where nobody says.
    """

    total_b: float | None = None
    active_b: float | None = None
    architecture: str = ""


@dataclass(frozen=True)
class ModelSpec:
    """One model of a campaign.

    Args:
        name: on the topics and in the results.
        options: of its backend; placeholders stand for what differs from cell to cell.
        attached: its bridge runs already, and isn't ours to start or stop.
        backend: name of a backend or ``module:factory``; empty: the model's name.
        interface: that it speaks; empty: the one of its backend and options.
        adapter: that reads its answers, ``name`` or ``name:mode``; empty: the interface's.
        timeout_s: for one answer; None: the campaign's.
        preprocessing: what differs from the interface's, by field of Preprocessing.
        facts: for reports.
        condition: under which it is asked (conditions.py); empty: as it is meant to be.
        control: it was added to check the harness, whatever it is; it enters no mean and no rank.
        answerer: it is one of the harness's own that was added; nobody has to start it.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    attached: bool = False
    backend: str = ""
    interface: str = ""
    adapter: str = ""
    timeout_s: float | None = None
    preprocessing: Mapping[str, Any] = field(default_factory=dict)
    facts: ModelFacts = ModelFacts()
    condition: str = ""
    control: bool = False
    answerer: bool = False

    @property
    def shown(self) -> str:
        """Its name in results, such as ``mine+black``: under a condition it is another cell."""
        return f"{self.name}+{self.condition}" if self.condition else self.name

    @property
    def backend_name(self) -> str:
        """The backend that answers; of an attached bridge it is known only if somebody says."""
        return self.backend or self.name

    @property
    def spoken(self) -> Interface:
        """What the model expects and gives.

        Raises:
            InputError: there is no such interface.
        """
        return find_interface(self.interface or interface_of(self.backend_name, self.options))

    @property
    def rules(self) -> Preprocessing:
        """Which frames and ego samples its requests hold."""
        return replace(self.spoken.preprocessing, **self.preprocessing)

    def read_by(self, override: str = "") -> str:
        """The adapter with its mode, as it stands in results.

        Args:
            override: adapter of the whole campaign; empty: the model's own.

        Raises:
            InputError: there is no such adapter.
        """
        return ":".join(check_adapter(override or self.adapter or self.spoken.adapter))

    def options_for(self, labels_file: str, clip_start_ns: int) -> dict[str, Any]:
        """The backend's options for one cell, or what stands for them in a key."""
        return _filled(self.options, {LABELS_FILE: labels_file, CLIP_START_NS: clip_start_ns})


def _filled(options: Mapping[str, Any], places: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: places.get(value, value) if isinstance(value, str) else value
        for key, value in options.items()
    }
