"""Every node's parameters are described, bounded, and refused where they'd have no effect."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import ssp_monitor.ros.parameters
from ssp_core.errors import InputError
from ssp_core.host.domains import free_domain
from ssp_core.host.shared_memory import remove_shared_ports
from ssp_core.node_interface import Parameter
from ssp_eval.ros import parameters as ssp_eval_params
from ssp_ot_controller.ros import parameters as ot_controller_params
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.ros import parameters as scenario_manager_params
from ssp_vla_bridge.ros import parameters as vla_bridge_params

TABLES: dict[str, tuple[Parameter, ...]] = {
    **ot_controller_params.NODES,
    **ssp_monitor.ros.parameters.NODES,
    **vla_bridge_params.NODES,
    **ssp_eval_params.NODES,
    **scenario_manager_params.NODES,
}
# rclpy's own, of any node.
ROS_OWN = {"use_sim_time", "start_type_description_service"}
Start = Callable[..., None]


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Sets ROS up with parameters for the nodes that are then made."""
    import rclpy

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with free_domain() as domain_id:

        def start(**given: object) -> None:
            words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
            monkeypatch.setattr(sys, "argv", ["node", "--ros-args", *words])
            rclpy.init(args=sys.argv, domain_id=domain_id)

        yield start
        rclpy.try_shutdown()
        remove_shared_ports(domain_id)


# Where each node is, and what it is given; what isn't stays as its table says.
MADE: dict[str, tuple[str, dict[str, object]]] = {
    "scenario_manager": ("ssp_scenario_manager.ros.manager_node:ScenarioManager", {}),
    "object_target": (
        "ssp_ot_controller.ros.object_target:ObjectTargetNode",
        {"run_file": "run.yaml", "autostart": "false"},
    ),
    "vut_adapter": (
        "ssp_ot_controller.ros.vut_adapter:VutAdapter",
        {"run_file": "run.yaml", "unit_forward_m": 1},
    ),
    "played_vut": ("ssp_ot_controller.ros.played_vut:PlayedVut", {"run_file": "run.yaml"}),
    "monitor": (
        "ssp_monitor.ros.monitor_node:MonitorNode",
        {"run_file": "run.yaml", "bag_dir": "bag"},
    ),
    "monitor_page": ("ssp_monitor.ros.page_node:MonitorPage", {"port": 0, "page_rate_hz": 5}),
    "view": ("ssp_monitor.ros.view_node:ViewNode", {}),
    "vla_bridge": ("ssp_vla_bridge.ros.vla_bridge:VlaBridge", {}),
}


def make(name: str, folder: Path, start: Start) -> Any:
    """The node itself, with files of a folder."""
    from ssp_core.ros import StopRequest

    place, given = MADE[name]
    start(**{k: folder / str(v) if k in ("run_file", "bag_dir") else v for k, v in given.items()})
    module, cls = place.split(":")
    node = getattr(importlib.import_module(module), cls)
    if name == "vla_bridge":
        return node("vla_bridge", namespace="/ssp")
    stops = name in ("object_target", "vut_adapter", "played_vut", "monitor_page")
    return node(StopRequest()) if stops else node()


@pytest.mark.parametrize("name", MADE)
def test_a_running_node_describes_its_parameters_and_refuses_to_change_them(
    name: str, started: Start, tmp_path: Path
) -> None:
    import rclpy.parameter

    run = prepare_run("cut_in", "north_track", tmp_path / "run", seed=None, mode="live")
    run_file = tmp_path / "run.yaml"
    run_file.write_text(run.model_dump_json(by_alias=True))
    node = make(name, tmp_path, started)
    try:
        described = {
            one: node.describe_parameter(one)
            for one in node._parameters
            if one not in ROS_OWN and not one.startswith("qos_overrides.")
        }
        table = {one.name: one for one in TABLES[name]}
        assert set(described) == set(table)
        for parameter, found in described.items():
            assert found.description == table[parameter].description
            assert found.additional_constraints
            bounded = bool(found.floating_point_range or found.integer_range)
            assert bounded == table[parameter].is_number
            assert found.read_only
            same = rclpy.parameter.Parameter(parameter, value=node.get_parameter(parameter).value)
            (result,) = node.set_parameters([same])
            assert not result.successful
            assert "read-only" in result.reason
    finally:
        if hasattr(node, "close"):
            node.close()
        node.destroy_node()


def test_the_replays_rate_can_be_set_inside_its_range_alone(started: Start) -> None:
    import rclpy
    from rclpy.parameter import Parameter as RosParameter

    from ssp_core.ros import declare

    started()
    node = rclpy.create_node("replay")
    declare(node, TABLES["replay"])
    for value, taken in ((2.0, True), (0.0, False), (float("nan"), False)):
        (result,) = node.set_parameters([RosParameter("rate", value=value)])
        assert result.successful == taken
        assert node.get_parameter("rate").value == 2.0
    node.destroy_node()


@pytest.mark.parametrize(
    ("table", "given", "says"),
    [
        ("monitor", {"queue_mb": 0}, "parameter queue_mb: is out of range (got 0)"),
        ("monitor", {"split_mb": -1.0}, "split_mb: is out of range"),
        ("monitor", {"bag_dir": 7}, "parameter bag_dir: must be a text (got 7)"),
        ("monitor", {"all": 1}, "all: must be true or false"),
        ("monitor_page", {"port": 65536}, "port: is out of range"),
        ("monitor_page", {"page_rate_hz": ".nan"}, "page_rate_hz: is out of range"),
        ("monitor_page", {"token": 1234567890123456}, "token: must be a text; "),
        ("vla_bridge", {"model": "7"}, "model: must be a text"),
        ("vla_bridge", {"model": "a-b"}, "model: must be letters, digits and underscores"),
        ("evaluator_settings", {"bags": "[1,2]"}, "bags: must be a list of bag directories"),
    ],
)
def test_a_wrong_value_is_one_message(
    started: Start, table: str, given: dict[str, object], says: str
) -> None:
    import rclpy

    from ssp_core.ros import declare

    started(**{"run_file": "run.yaml", "bag_dir": "bag", **given})
    node = rclpy.create_node("any")
    with pytest.raises(InputError, match="parameter ") as caught:
        declare(node, TABLES[table])
    assert says in str(caught.value)
    node.destroy_node()


def test_nothing_declares_a_parameter_but_the_one_function() -> None:
    root = Path(__file__).resolve().parents[1]
    declaring = {
        str(path.relative_to(root))
        for path in root.glob("ssp_*/ssp_*/**/*.py")
        if "declare_parameter(" in path.read_text()
    }
    assert declaring == {"ssp_msgs/ssp_core/ros/__init__.py"}


@pytest.mark.parametrize("name", list(TABLES))
def test_each_default_fits_and_each_parameter_is_explained(name: str) -> None:
    for one in TABLES[name]:
        assert one.description
        assert one.required or one.check(one.default) == one.default
        assert not one.is_number or one.least < one.most
