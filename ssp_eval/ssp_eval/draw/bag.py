"""The bag of a recording that was drawn anew: its messages, and other pictures."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.operations.derived import begin_derived
from ssp_core.bag.writing.chain import Maker
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.carla.record import CarlaScene, encode_server
from ssp_core.cdr.images import COMPRESSED_TYPE
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.files.folders import new_folder
from ssp_core.names import CAMERA_RENDERER, absolute
from ssp_core.run_file.verdict import VERDICT_FILE
from ssp_core.world.camera import intrinsics
from ssp_core.world.camera_messages import encode_camera_info, encode_frame
from ssp_core.world.transforms import encode_transform, mount
from ssp_eval.data.drawn import DRAWN_ATTACHMENT, Redrawing
from ssp_eval.data.provenance import bag_folder
from ssp_eval.draw.pictures import Pictures
from ssp_eval.draw.scenes import IMAGE, DrawableRecording
from ssp_eval.importers.target import INFO, MOUNT

_RENDERER = absolute(CAMERA_RENDERER)


def write_redrawing(
    recorded: DrawableRecording,
    pictures: Pictures,
    server: CarlaScene,
    redrawing: Redrawing,
    target: Path,
) -> None:
    """Write the new bag, which is whole or not there.

    Args:
        recorded: the recording that is drawn anew.
        pictures: one of each frame, but for those that are left out.
        server: that drew them.
        redrawing: identity of the drawing, which the new bag carries.
        target: folder of the new bag, which doesn't exist yet.

    Raises:
        InputError: the target exists, or the recording isn't what was sealed.
        HostError: the disk doesn't take it.
    """
    bag, changes = recorded.bag, _changes(recorded, pictures)
    identity = redrawing.model_dump_json(by_alias=True, indent=1).encode() + b"\n"
    with new_folder(target) as folder:
        with BagWriter(folder, name=f"{target.name}_0", maker=Maker.DRAW) as writer:
            begin_derived(
                writer,
                bag,
                {DRAWN_ATTACHMENT: identity},
                but={_RENDERER},
                types={IMAGE: COMPRESSED_TYPE},
            )
            writer.add_topic(
                _RENDERER, "std_msgs/msg/String", offered_qos(1, transient_local=True), latched=True
            )
            server_record = encode_server(server.model_dump(mode="json", by_alias=True))
            begun_ns = bag.start_ns or 0
            writer.write(_RENDERER, server_record, begun_ns, begun_ns)
            for message in bag.messages([name for name in bag.topics if name != _RENDERER]):
                change = changes.get(message.topic)
                data = message.data if change is None else change(message.data)
                if data is not None:
                    writer.write_all([message._replace(data=data)])
        verdict_file = bag_folder(bag.path) / VERDICT_FILE
        if verdict_file.is_file():
            shutil.copyfile(verdict_file, folder / VERDICT_FILE)


def _changes(
    recorded: DrawableRecording, pictures: Pictures
) -> dict[str, Callable[[bytes], bytes | None]]:
    """Give the change of each topic that has one; it gives None for a message that is left out."""
    lens = intrinsics(recorded.camera)
    mounted = encode_transform(mount(recorded.camera))

    def picture(data: bytes) -> bytes | None:
        stamp_ns = peek_stamp_ns(data)
        return encode_frame(stamp_ns, pictures.get(stamp_ns)) if pictures.has(stamp_ns) else None

    def info(data: bytes) -> bytes:
        return encode_camera_info(peek_stamp_ns(data), lens)

    return {IMAGE: picture, INFO: info, MOUNT: lambda _: mounted}
