"""Types that are neither ROS's own nor ours, from the .msg files of installed packages."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.bag.types import (
    TypeDefinition,
    definition,
    installed_file,
    installed_types,
    store_from,
    typestore,
)
from ssp_core.errors import InputError


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation with two packages, of which one uses the other and ROS's own."""
    texts = {
        "lab_msgs/msg/Rig.msg": "std_msgs/Header header\nArm[2] arms\nother_msgs/Tag[] tags\n",
        "lab_msgs/msg/Arm.msg": "float64 angle\nuint8 LEFT=1\n",
        "other_msgs/msg/Tag.msg": "string name\n",
        "lab_msgs/msg/Broken.msg": "= = =\n",
        "lab_msgs/msg/Lacks.msg": "Nowhere thing\n",
        "lab_msgs/msg/Huge.msg": "#" * ((1 << 20) + 1),
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
    assert store.deserialize_cdr(
        store.serialize_cdr(tag, "other_msgs/msg/Tag"), "other_msgs/msg/Tag"
    ) == tag  # fmt: skip


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("lab_msgs/msg/Absent", "is no known message type"),
        ("lab_msgs/msg/Broken", "is no message definition"),
        ("lab_msgs/msg/Lacks", "Nowhere: is no known message type"),
        ("lab_msgs/msg/Huge", "is too large"),
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
