"""The part of a run file that says who drives the VUT of a driven session (METHOD 8.2)."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ssp_core.hashing import sha256_json
from ssp_core.run_file.latency import ZERO_LATENCY, LatencyField
from ssp_core.run_file.values import NonNegative, Positive, Strict

# They command the VUT without plans: as the twin is led, and as an open-loop session is.
NO_RESPONSE, BUILT_IN = "no_response", "built_in"
COMMANDED = (NO_RESPONSE, BUILT_IN)
# A part of topics, as a model's name is.
_NAME = r"^[A-Za-z][A-Za-z0-9_]{0,63}$"
DriverName = Annotated[str, Field(pattern=_NAME)]
# Parts of a compiled run that a driven one has none of (METHOD 8.2).
LeftOut = Literal["traffic", "adaptation"]


def is_driver_name(text: str) -> bool:
    """Tell whether a driver can have this name."""
    return re.fullmatch(_NAME, text) is not None


class Driven(Strict):
    """A driver that leads the VUT from the hand-over on, and the instants that its start fixed."""

    driver: DriverName
    options: dict[str, Any] = Field({}, description="of the driver")
    latency: LatencyField = Field(
        ZERO_LATENCY, description="L: zero, fixed:S, or measured:S with its declared bound"
    )
    first_request_s: NonNegative = Field(description="no frame before it is asked about")
    hand_over_s: NonNegative = Field(description="t_h")
    end_s: Positive = Field(description="T_end: the run ends here, or 1 s after the first contact")
    frame_period_s: Positive = Field(0.1, description="between the frames that are asked about")
    observable_s: NonNegative | None = Field(
        None, description="T_obs, for privileged drivers alone; null: it isn't known"
    )
    start: str = Field("", description="hash of the start; empty: of none")
    repeat: Annotated[int, Field(ge=0)] = Field(
        0, description="of the start under this driver, from 0; each has a seed of its own"
    )
    left_out: list[LeftOut] = Field(
        [], description="parts of the compiled run that a driven run has none of"
    )

    def sampling_seed(self, run_seed: int) -> int:
        """Return the seed of a driver that samples (METHOD 8.7).

        Repeats of a start have different ones. A run and its event-free twin share one, as do all
        drivers and latencies on a start: such runs differ by nothing that was drawn.

        Args:
            run_seed: of the run.

        Returns:
            Below 2^31, which every generator of random numbers takes.
        """
        digest = sha256_json([run_seed, self.start, self.repeat]).rpartition(":")[2]
        return int(digest[:8], 16) >> 1

    @model_validator(mode="after")
    def _instants_rise(self) -> Driven:
        if not self.first_request_s <= self.hand_over_s < self.end_s:
            raise ValueError("first_request_s, hand_over_s and end_s must rise")
        return self
