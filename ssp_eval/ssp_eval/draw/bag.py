"""The bag of a recording that was drawn anew: its messages, and other pictures."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from ssp_core.bag.chain import Maker
from ssp_core.bag.mcap_file import McapFile
from ssp_core.bag.metadata import is_latched, offered_qos, usable_qos
from ssp_core.bag.reader import BagReader
from ssp_core.bag.seal import source_of
from ssp_core.bag.writer import BagWriter
from ssp_core.carla.record import CarlaScene
from ssp_core.cdr.codec import ENCAPSULATION, text_bytes
from ssp_core.cdr.images import COMPRESSED_TYPE
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.files import new_folder
from ssp_core.hashing import canonical_json
from ssp_core.names import CAMERA_RENDERER, absolute
from ssp_core.run_file.verdict import VERDICT_FILE
from ssp_core.world.camera import intrinsics
from ssp_core.world.camera_messages import encode_camera_info, encode_frame
from ssp_core.world.transforms import encode_transform, mount
from ssp_eval.data.drawn import DRAWN_ATTACHMENT, Drawn
from ssp_eval.data.provenance import bag_folder
from ssp_eval.draw.pictures import Pictures
from ssp_eval.draw.scenes import IMAGE, Recorded
from ssp_eval.importers.target import INFO, MOUNT

_RENDERER = absolute(CAMERA_RENDERER)
# Of the recorder, on what it received: a bag that was drawn anew was recorded by nobody.
_LEFT_OUT_ATTACHMENTS = frozenset({"recording.json"})


def write_drawn(
    recorded: Recorded, pictures: Pictures, server: CarlaScene, drawn: Drawn, target: Path
) -> None:
    """Write the new bag, which is whole or not there.

    Args:
        pictures: one of each frame, but for those that are left out.
        server: that drew them.

    Raises:
        InputError: the target exists, or the recording isn't what was sealed.
        HostError: the disk doesn't take it.
    """
    bag, lens = recorded.bag, intrinsics(recorded.camera)
    with new_folder(target) as folder:
        with BagWriter(folder, name=f"{target.name}_0", maker=Maker.DRAW) as writer:
            writer.add_sources(source_of(bag))
            _begin(writer, bag, drawn)
            said = canonical_json(server.model_dump(mode="json", by_alias=True)).decode()
            begun_ns = bag.start_ns or 0
            writer.write(_RENDERER, ENCAPSULATION + text_bytes(said), begun_ns, begun_ns)
            for message in bag.messages(_kept_topics(bag)):
                data = message.data
                if message.topic in (IMAGE, INFO):
                    stamp_ns = peek_stamp_ns(data)
                    if not pictures.has(stamp_ns):
                        if message.topic == IMAGE:
                            continue
                    elif message.topic == IMAGE:
                        data = encode_frame(stamp_ns, pictures.get(stamp_ns))
                    if message.topic == INFO:
                        data = encode_camera_info(stamp_ns, lens)
                elif message.topic == MOUNT:
                    data = encode_transform(mount(recorded.camera))
                writer.write_all([message._replace(data=data)])
        told = bag_folder(bag.path) / VERDICT_FILE
        if told.is_file():
            shutil.copyfile(told, folder / VERDICT_FILE)


def _kept_topics(bag: BagReader) -> Sequence[str]:
    return [name for name in bag.topics if name != _RENDERER]


def _begin(writer: BagWriter, bag: BagReader, drawn: Drawn) -> None:
    """Announce the topics, and attach what the recording holds and what the new bag is."""
    for file in bag.files:
        part = McapFile(file)
        for index in part.summary.attachment_indexes:
            data = part.attachment(index.name)
            if data is not None and index.name not in _LEFT_OUT_ATTACHMENTS:
                writer.attach(index.name, data, index.media_type)
    told = drawn.model_dump_json(by_alias=True, indent=1).encode() + b"\n"
    writer.attach(DRAWN_ATTACHMENT, told, "application/json")
    for name in _kept_topics(bag):
        info = bag.topics[name]
        qos = usable_qos(info.offered_qos)
        if name == IMAGE:
            writer.add_topic(name, COMPRESSED_TYPE, qos)
        else:
            latched = is_latched(info.offered_qos)
            writer.add_topic(name, info.msgtype, qos, written=bag.definition(name), latched=latched)
    writer.add_topic(_RENDERER, "std_msgs/msg/String", offered_qos(1, transient_local=True),
                     latched=True)  # fmt: skip
