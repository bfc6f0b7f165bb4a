"""The bag that an import makes: whole or not there."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ssp_core import names
from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.writer import BagWriter
from ssp_core.cdr.states import encode_state
from ssp_core.errors import InputError
from ssp_core.files import make_folder
from ssp_core.motion.state import ObjectState
from ssp_core.world.transforms import TF_TYPE, encode_transforms, of_state
from ssp_eval.imports import messages
from ssp_eval.imports.declare import Declared
from ssp_eval.imports.road import BoundRoad
from ssp_eval.recordings.import_record import IMPORT_ATTACHMENT, ImportRecord
from ssp_scenario_manager.compile.task import EVENT_FILE
from ssp_scenario_manager.event_spec.log import Record, append_record, utc_now

IMAGE = names.absolute(names.CAMERA_IMAGE)
INFO = names.absolute(names.CAMERA_INFO)
MOUNT = names.absolute(names.CAMERA_MOUNT)

Made = TypeVar("Made")


@dataclass(frozen=True)
class ImportSummary:
    """What was imported.

    Args:
        bag: the directory.
        frames: kept.
        keep_every: every n-th source frame was kept.
        rate_hz: of the kept frames.
        duration_s: clip time of the last frame.
        width_px: of the stored frames.
        height_px: of the stored frames.
        record: the content of import.json.
    """

    bag: Path
    frames: int
    keep_every: int
    rate_hz: float
    duration_s: float
    width_px: int
    height_px: int
    record: ImportRecord

    def as_json(self) -> dict[str, object]:
        """For programs."""
        return {
            "bag": str(self.bag),
            "frames": self.frames,
            "keep_every": self.keep_every,
            "rate_hz": self.rate_hz,
            "duration_s": self.duration_s,
            "width_px": self.width_px,
            "height_px": self.height_px,
            "import": self.record.model_dump(mode="json", by_alias=True),
        }

    @property
    def text(self) -> str:
        """For people, one line."""
        return (
            f"{self.bag}: {self.frames} frames of {self.width_px}x{self.height_px} px, "
            f"{self.duration_s:.3f} s"
        )


def check_free(out: Path) -> None:
    """Raises InputError where something is already there."""
    if out.exists() or out.is_symlink():
        raise InputError("exists already", file=out, remedy="name a new directory with --out")


def make_bag(out: Path, fill: Callable[[BagWriter], Made]) -> Made:
    """Makes a bag directory in a folder beside it and puts it in place when it is whole.

    Args:
        out: of the bag; must not exist.
        fill: writes the messages and attachments.

    Raises:
        InputError: the directory exists, or what ``fill`` raises; nothing is left behind.
    """
    check_free(out)
    make_folder(out.parent)
    scratch = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    try:
        with BagWriter(scratch / "bag", name=f"{out.name}_0") as writer:
            made = fill(writer)
        (scratch / "bag").rename(out)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return made


def write_states(writer: BagWriter, tracks: Mapping[str, Iterable[ObjectState]]) -> None:
    """Each object's states on its own topic, and all as poses on /tf; log times as their stamps.

    Args:
        writer: of the bag.
        tracks: states by object id.
    """
    at: dict[int, list[ObjectState]] = {}
    for object_id, states in tracks.items():
        topic = names.absolute(names.state_topic(object_id))
        writer.add_topic(topic, messages.STATE_TYPE, offered_qos(50))
        for state in states:
            writer.write(topic, encode_state(state), state.stamp_ns, state.stamp_ns, state.sequence)
            at.setdefault(state.stamp_ns, []).append(state)
    writer.add_topic(names.TF, TF_TYPE, offered_qos(100))
    for count, (stamp_ns, present) in enumerate(sorted(at.items()), 1):
        poses = encode_transforms(map(of_state, present))
        writer.write(names.TF, poses, stamp_ns, stamp_ns, count)


def attach_record(
    writer: BagWriter, record: ImportRecord, declared: Declared, road: BoundRoad | None
) -> None:
    """import.json, the K* and the map."""
    data = record.model_dump_json(by_alias=True, indent=1).encode() + b"\n"
    writer.attach(IMPORT_ATTACHMENT, data, "application/json")
    if declared.event_file is not None:
        writer.attach(EVENT_FILE, declared.event_file, "application/yaml")
    if road is not None:
        writer.attach(road.site.attachment, road.data, "application/octet-stream")


def log_source(summary: ImportSummary, who: str) -> None:
    """Enters where a recording comes from into log L, beside the bag (METHOD 1).

    Hash, generator, original and crop, and what named persons declared.

    Args:
        summary: of the import.
        who: the program.
    """
    record = summary.record
    details: dict[str, object] = {
        "generator": record.generator,
        "original": record.source_name,
        "sha256": record.source_sha256,
        "crop": record.crop,
    }
    if record.states is not None:
        details["states"] = {"name": record.states.name, "sha256": record.states.sha256}
    if record.site is not None:
        details["site"] = {"name": record.site.name, "sha256": record.site.sha256}
    if record.declaration is not None:
        details["domain"] = f"{record.domain}, {record.declaration.text}"
    if record.log is not None:
        details["declared"] = record.log.model_dump(mode="json")
    entry = Record(
        kind="source",
        when=utc_now(),
        who=who,
        subject=record.scenario or record.source_name,
        version=record.event_version,
        reason="imported as a bag",
        details=details,
    )
    append_record(summary.bag.with_name(f"{summary.bag.name}.log.jsonl"), entry)
