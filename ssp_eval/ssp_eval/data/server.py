"""The CARLA server that drew or moved a run, by its bag and the probe beside it."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ssp_core.bag.reading.reader import BagReader
from ssp_core.carla.probe_report import CarlaProbeReport, load_report
from ssp_core.carla.record import CarlaPlantRecord, CarlaScene
from ssp_core.cdr.codec import START, read_text
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping, parse_model
from ssp_core.hashing import sha256_file
from ssp_core.names import absolute

# Beside a bag that CARLA drew, or in it: the probe of the server.
PROBE_FILE = "carla_probe.json"


@dataclass(frozen=True)
class ServerProbe:
    """The file of a probe of the server that drew a recording."""

    report: CarlaProbeReport
    sha256: str


ServerRecord = TypeVar("ServerRecord", CarlaScene, CarlaPlantRecord)


def read_server(bag: BagReader, topic: str, record: type[ServerRecord]) -> ServerRecord | None:
    """Read what the server is that drew or moved a run, by its last word; None: there is none.

    Raises:
        InputError: it isn't valid.
    """
    data = None
    for message in bag.messages([absolute(topic)]):
        data = message.data
    if data is None:
        return None
    place = f"{bag.path}:{absolute(topic)}"
    try:
        text, _ = read_text(data, START)
    except (ValueError, struct.error) as error:
        raise InputError(
            f"is no text: {error}", file=place, remedy="record the session again"
        ) from error
    return parse_model(record, parse_mapping(text.encode(), place), place)


def read_probe(folder: Path) -> ServerProbe | None:
    """Read the probe in a bag's folder or beside it; None: there is none.

    Raises:
        InputError: it is no report of a probe.
    """
    for file in (folder / PROBE_FILE, folder.parent / PROBE_FILE):
        if file.is_file():
            return ServerProbe(load_report(file), sha256_file(file))
    return None
