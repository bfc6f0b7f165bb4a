"""Where the message types come from, and what a bag's own definitions may do."""

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
from ssp_core.bag.types import TypeDefinition, definition, serialize, store_from, typestore
from ssp_core.errors import InputError

SOURCES = Path(ssp_core.__file__).parent
SHOW = """
from ssp_core.bag.types import definition
print(len(definition("ssp_msgs/msg/WorldTick").text))
"""


def run_copy(site: Path, prefix: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site), "AMENT_PREFIX_PATH": prefix}
    return subprocess.run(
        [sys.executable, "-c", SHOW], env=environment, capture_output=True, text=True,
        check=False, timeout=600,
    )  # fmt: skip


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
