"""The sources of the message types, and the limits of a bag's own definitions."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.serde import SerdeError

import ssp_core
from ssp_core.bag.types import (
    TypeDefinition,
    definition,
    installed_file,
    installed_types,
    serialize,
    store_from,
    typestore,
)
from ssp_core.errors import InputError

SOURCES = Path(ssp_core.__file__).parent
SHOW = """
from ssp_core.bag.types import definition
print(len(definition("ssp_msgs/msg/WorldTick").text))
"""


def run_copy(site: Path, prefix: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site), "AMENT_PREFIX_PATH": prefix}
    return subprocess.run(
        [sys.executable, "-c", SHOW],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )


@pytest.mark.parametrize("place", ["site/ssp_core/interfaces", "prefix/share/ssp_msgs/msg"])
def test_types_are_found_in_a_wheel_and_in_a_ros_prefix(tmp_path: Path, place: str) -> None:
    shutil.copytree(SOURCES, tmp_path / "site" / "ssp_core")
    shutil.copytree(SOURCES.parent / "msg", tmp_path / place)
    done = run_copy(tmp_path / "site", f"/nowhere:{tmp_path / 'prefix'}")
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 1000


def test_missing_types_say_where_they_were_looked_for(tmp_path: Path) -> None:
    shutil.copytree(SOURCES, tmp_path / "site" / "ssp_core")
    (tmp_path / "site" / "msg").mkdir()
    done = run_copy(tmp_path / "site", str(tmp_path / "prefix"))
    assert "HostError" in done.stderr
    assert str(tmp_path / "prefix/share/ssp_msgs/msg") in done.stderr


def test_every_interface_has_a_definition_that_stands_alone() -> None:
    store = typestore()
    own = [name for name in store.types if name.startswith("ssp_msgs/msg/")]
    assert {"ssp_msgs/msg/WorldTick", "ssp_msgs/msg/VlaRequest"} <= set(own)
    for name in own:
        assert name in store_from(definition(name)).types


def test_serialize_takes_only_messages() -> None:
    with pytest.raises(TypeError, match="no message"):
        serialize(3)


@pytest.mark.parametrize(
    ("encoding", "text", "match"),
    [
        ("protobuf", "", "unknown encoding"),
        ("ros2msg", "float64 = = x\n", "can't be used"),
        ("ros2msg", "other/Thing x\n", "can't be used"),
        ("ros2idl", "module {", "can't be used"),
    ],
)
def test_a_definition_that_cannot_be_used_is_an_input_error(
    encoding: str, text: str, match: str
) -> None:
    with pytest.raises(InputError, match=match):
        store_from(TypeDefinition("a/msg/B", encoding, text))


@pytest.mark.parametrize("numbers", [b"", struct.pack("<d", 2.5)])
def test_padding_before_no_numbers_is_no_damage(numbers: bytes) -> None:
    """rclpy aligns to 8 bytes behind the count of an empty sequence of doubles; rosbags doesn't."""
    name = "std_msgs/msg/Float64MultiArray"
    store = store_from(definition(name))
    count = struct.pack("<I", len(numbers) // 8)
    message = bytes([0, 1, 0, 0]) + bytes(8) + count + bytes(4) + numbers
    found = store.deserialize_cdr(message, name)
    assert list(found.data) == ([2.5] if numbers else [])
    with pytest.raises(SerdeError, match="size mismatch"):
        store.deserialize_cdr(message + bytes(8), name)
    other = "std_msgs/msg/UInt32"
    with pytest.raises(SerdeError, match="size mismatch"):
        store_from(definition(other)).deserialize_cdr(bytes([0, 1, 0, 0]) + bytes(8), other)


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation with two packages, of which one uses the other and ROS's own."""
    texts = {
        "lab_msgs/msg/Rig.msg": "std_msgs/Header header\nArm[2] arms\nother_msgs/Tag[] tags\n",
        "lab_msgs/msg/Arm.msg": "float64 angle\nuint8 LEFT=1\n",
        "other_msgs/msg/Tag.msg": "string name\n",
        "lab_msgs/msg/Broken.msg": "= = =\n",
        "lab_msgs/msg/Lacks.msg": "Nowhere thing\n",
    }
    for name, text in texts.items():
        path = tmp_path / "share" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere::{tmp_path}")
    return tmp_path


def test_a_type_comes_with_all_that_it_uses(prefix: Path) -> None:
    found = installed_types("lab_msgs/msg/Rig", typestore().fielddefs)
    assert set(found) == {"lab_msgs/msg/Rig", "lab_msgs/msg/Arm", "other_msgs/msg/Tag"}
    written = definition("lab_msgs/msg/Rig")
    assert written.type_hash.startswith("RIHS01_")
    # The text alone is enough for a reader that knows none of these packages.
    store = store_from(TypeDefinition("lab_msgs/msg/Rig", written.encoding, written.text))
    tag = store.types["other_msgs/msg/Tag"](name="left")
    assert (
        store.deserialize_cdr(store.serialize_cdr(tag, "other_msgs/msg/Tag"), "other_msgs/msg/Tag")
        == tag
    )


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("lab_msgs/msg/Absent", "is no known message type"),
        ("lab_msgs/msg/Broken", "is no message definition"),
        ("lab_msgs/msg/Lacks", "Nowhere: is no known message type"),
        ("../../lab_msgs/msg/Rig", "is no known message type"),
        ("lab_msgs/action/Rig", "is no known message type"),
    ],
)
def test_what_is_no_type_is_refused(prefix: Path, name: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        definition(name)
    assert name not in typestore().fielddefs


def test_a_name_is_no_path(prefix: Path) -> None:
    (prefix / "Rig.msg").write_text("uint8 x\n")
    assert installed_file("lab_msgs/msg/Rig") == prefix / "share" / "lab_msgs/msg/Rig.msg"
    for name in ("lab_msgs/msg/../../../Rig", "/msg/Rig", "lab_msgs/msg/Rig\n", "lab_msgs/Rig"):
        assert installed_file(name) is None
