"""The layouts for Foxglove and RViz name topics that exist."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core import names
from ssp_core.bag.types import typestore
from ssp_core.run_file.model import RunSpec
from ssp_monitor.recorder.topics import bag_topics
from ssp_monitor.ros.view_node import PUBLISHED

CONFIG = Path(__file__).resolve().parents[2] / "config"
SPLIT = {"direction", "first", "second", "splitPercentage"}


@pytest.fixture
def topics(run_mapping):
    """Everything that a session with object ot1 publishes, and the view, with types."""
    run = RunSpec.model_validate(run_mapping)
    found = {topic.name: topic.msgtype for topic in bag_topics(run)}
    found |= {"/rosout": "rcl_interfaces/msg/Log"} | PUBLISHED
    # Published where a process serves more objects than have topics of their own.
    found[names.absolute(names.OBJECT_STATES)] = "ssp_msgs/msg/ObjectStates"
    return found


@pytest.fixture
def layout():
    text = (CONFIG / "ssp.foxglove-layout.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def _leaves(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
        return
    assert set(layout) == SPLIT
    assert layout["direction"] in ("row", "column")
    assert 0 < layout["splitPercentage"] < 100
    yield from _leaves(layout["first"])
    yield from _leaves(layout["second"])


def test_every_panel_is_shown_once(layout):
    panels = layout["configById"]
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    shown = list(_leaves(layout["layout"]))
    for name, config in panels.items():
        kind, mark, number = name.partition("!")
        assert mark, name
        assert number, name
        if kind == "Tab":
            for tab in config["tabs"]:
                assert set(tab) == {"title", "layout"}
                shown += _leaves(tab["layout"])
    assert sorted(shown) == sorted(panels)


def _exists(path: str, topics: dict[str, str]) -> None:
    """A message path: a topic that exists, and fields of its type; lists have a slice."""
    topic, *fields = path.split(".")
    assert topic in topics, path
    msgtype, indexed = topics[topic], False
    for word in fields:
        assert not indexed or msgtype, path
        field = re.fullmatch(r"(\w+)(\[:\])?", word)
        assert field is not None, path
        kinds = dict(typestore().fielddefs[msgtype][1])
        assert field[1] in kinds, path
        kind, what = kinds[field[1]]
        # 1 a builtin, 2 another message, 3 and 4 lists of these.
        is_list = int(kind) in (3, 4)
        assert is_list == (field[2] is not None), path
        if is_list:
            kind, what = what[0]
        msgtype = what if int(kind) == 2 else ""


def test_foxglove_is_given_topics_and_fields_that_exist(layout, topics):
    paths = []
    for config in layout["configById"].values():
        paths += [path["value"] for path in config.get("paths", [])]
        paths += list(config.get("topics", {}))
        paths += [config[key] for key in ("topicPath", "topicToRender") if key in config]
        mode = config.get("imageMode", {})
        paths += [mode[key] for key in ("imageTopic", "calibrationTopic") if key in mode]
    assert len(paths) > 20
    for path in paths:
        _exists(path, topics)
    with pytest.raises(AssertionError):
        _exists("/ssp/vut/state.nothing", topics)
    with pytest.raises(AssertionError):
        _exists("/ssp/object_states.states.speed", topics)


def _displays() -> list[dict[str, Any]]:
    config = yaml.safe_load((CONFIG / "ssp.rviz").read_text(encoding="utf-8"))
    assert set(config) == {"Panels", "Visualization Manager", "Window Geometry"}
    manager = config["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == names.MAP_FRAME
    found: list[dict[str, Any]] = manager["Displays"]
    return found


def test_rviz_is_given_topics_with_the_types_of_its_displays(topics):
    wanted = {
        "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
        "rviz_default_plugins/Image": "sensor_msgs/msg/CompressedImage",
    }
    shown = [display for display in _displays() if "Topic" in display]
    assert len(shown) == 3
    for display in shown:
        assert topics[display["Topic"]["Value"]] == wanted[display["Class"]]
        assert display["Enabled"] is True


def test_rviz_hears_the_latched_scene_and_names_policies_as_it_knows_them():
    for display in _displays():
        if "Topic" not in display:
            continue
        topic = display["Topic"]
        latched = topic["Value"].endswith("markers/scene")
        assert topic["Durability Policy"] == ("Transient Local" if latched else "Volatile")
        assert topic["History Policy"] == "Keep Last"
        assert topic["Reliability Policy"] == "Reliable"
