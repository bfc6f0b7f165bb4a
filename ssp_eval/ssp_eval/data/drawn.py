"""The attachment of a bag whose pictures were drawn anew from its states (``drawn.json``)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from ssp_core.bag.reading.reader import BagReader
from ssp_core.files.reading import parse_mapping, parse_model
from ssp_core.run_file.values import Strict

DRAWN_SCHEMA: Literal["ssp.drawn/1"] = "ssp.drawn/1"
DRAWN_ATTACHMENT = "drawn.json"

Digest = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0)]


class Redrawing(Strict):
    """The recording whose states were drawn, and what is new."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.drawn/1"] = Field(DRAWN_SCHEMA, alias="schema")
    of: str = Field(description="name of the recording")
    of_sha256: Digest = Field(description="hash of its bag")
    renderer: Literal["carla"] = "carla"
    map_file: str = Field(description="name of the OpenDRIVE file that the server's map is")
    map_sha256: Digest = Field(description="of its text, whatever its line ends are")
    map_said_by: Literal["the task", "--map"]
    frames: Count = Field(description="pictures that were drawn, each for one stamp")
    left_out: Count = Field(description="frames at which no state of the VUT is known")
    software: str

    @property
    def text(self) -> str:
        """Describe the bag, for people."""
        description = f"drawn anew by CARLA from the states of {self.of} ({self.of_sha256})"
        if self.left_out:
            description += f", without {self.left_out} frames at which no state of the VUT is known"
        return description


def read_redrawing(bag: BagReader) -> Redrawing | None:
    """Read of which recording the pictures were drawn anew; None: they are its own."""
    data = bag.attachment(DRAWN_ATTACHMENT)
    if data is None:
        return None
    place = f"{bag.path}:{DRAWN_ATTACHMENT}"
    return parse_model(Redrawing, parse_mapping(data, place), place)
