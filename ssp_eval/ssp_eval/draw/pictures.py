"""The pictures of a drawing that isn't finished, in a folder, from which the drawing is continued.

Each file is whole or not there, so that a drawing may be killed at any time.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Literal

from pydantic import ConfigDict, Field

from ssp_core.carla.record import CarlaScene, with_bodies
from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_bytes, write_json
from ssp_core.run_file.values import Strict
from ssp_eval.data.drawn import Digest

DRAWING_FILE = "drawing.json"
_SUFFIX = ".drawing"


class Drawing(Strict):
    """``drawing.json``: of what the pictures are, and the server that draws them."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.drawing/1"] = Field("ssp.drawing/1", alias="schema")
    of_sha256: Digest
    map_sha256: Digest
    server: CarlaScene


class Pictures:
    """The folder of an unfinished drawing.

    Args:
        target: the bag that it becomes; the folder lies beside it.

    Raises:
        InputError: the folder holds a drawing of another recording or map.
    """

    def __init__(self, target: Path, of_sha256: str, map_sha256: str) -> None:
        self.folder = target.with_name(target.name + _SUFFIX)
        self._of, self._map = of_sha256, map_sha256
        self.server: CarlaScene | None = None
        file = self.folder / DRAWING_FILE
        if not file.is_file():
            return
        there = load_model(Drawing, file)
        for field, stored_sha256, required_sha256 in (
            ("of_sha256", there.of_sha256, of_sha256),
            ("map_sha256", there.map_sha256, map_sha256),
        ):
            if stored_sha256 != required_sha256:
                raise InputError(
                    "holds a drawing of another recording or map",
                    file=file,
                    field=field,
                    value=stored_sha256,
                    remedy="name another bag with --out, or remove the folder",
                )
        self.server = there.server

    def take_server(self, server: CarlaScene) -> None:
        """Keep what a server is.

        Raises:
            InputError: it isn't as the one was that drew the pictures before.
        """
        before = self.server
        if before is not None and (apart := before.differences(server)):
            raise InputError(
                "was drawn by a server that isn't this one: " + ", ".join(apart),
                file=self.folder / DRAWING_FILE,
                field="server",
                remedy="go on with that one, or remove the folder",
            )
        if before is not None:
            server = with_bodies(server, before.bodies)
            server = server.model_copy(update={"first_frame": before.first_frame})
        if server != before:
            self.server = server
            drawing = Drawing(of_sha256=self._of, map_sha256=self._map, server=server)
            file = self.folder / DRAWING_FILE
            write_json(file, drawing.model_dump(mode="json", by_alias=True))

    def has(self, stamp_ns: int) -> bool:
        """Return True for a picture that was drawn."""
        return self._file(stamp_ns).is_file()

    def put(self, stamp_ns: int, jpeg: bytes) -> None:
        """Keep a picture."""
        write_bytes(self._file(stamp_ns), jpeg)

    def get(self, stamp_ns: int) -> bytes:
        """Return a picture that was drawn."""
        return self._file(stamp_ns).read_bytes()

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _file(self, stamp_ns: int) -> Path:
        return self.folder / f"{stamp_ns:020d}.jpg"
