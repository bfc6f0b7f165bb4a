"""Launch files of all packages, with a stand-in for launch and launch_ros.

The wheels have neither; what can go wrong without them is a name: of an executable, a parameter, an
argument or a file.
"""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from ssp_core.errors import InputError
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.compile.targets.folder import prepare_run

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted(ROOT.glob("ssp_*/launch/*.launch.py"))
SIL = ROOT / "ssp_scenario_manager" / "launch" / "sil.launch.py"
TRACK = SIL.with_name("track.launch.py")


class Thing:
    """Any class of launch: keeps what it was made with."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs

    @property
    def kind(self) -> str:
        return type(self).__name__

    def perform(self, context: dict[str, str]) -> str:
        """Return the argument's value in the context, as a LaunchConfiguration does."""
        return context[self.args[0]]


class Module(ModuleType):
    """A module that has every class."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        made = type(name, (Thing,), {})
        setattr(self, name, made)
        return made


@pytest.fixture
def entities(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], list[Thing]]:
    """Loads a launch file and gives the entities of its description."""
    for name in (
        *("launch", "launch.actions", "launch.conditions", "launch.substitutions"),
        *("launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions"),
        "launch_ros.substitutions",
    ):
        monkeypatch.setitem(sys.modules, name, Module(name))

    def load(path: Path) -> list[Thing]:
        description = runpy.run_path(str(path))["generate_launch_description"]()
        made: list[Thing] = description.args[0]
        return made

    return load


def things(value: Any) -> Iterator[Thing]:
    """Everything inside a description, at any depth."""
    if isinstance(value, Thing):
        yield value
        value = [value.args, list(value.kwargs.values())]
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for inner in value:
            yield from things(inner)


def executables(package: str) -> list[str]:
    """Console scripts of a package's setup.py."""
    return re.findall(r'"(\w+) = [\w.]+:\w+"', (ROOT / package / "setup.py").read_text())


def declared_parameters(package: str, executable: str) -> set[str]:
    """Names that a node declares."""
    node = {"page": "monitor_page"}.get(executable, executable)
    return {one.name for one in import_module(f"{package}.ros.parameters").NODES[node]}


# Tools of ROS that a launch file may start on request; they aren't ours to look into.
TOOLS = {"rviz2"}


def check_node(node: Thing) -> None:
    if node.kwargs["package"] in TOOLS:
        assert "condition" in node.kwargs, "started only where it is asked for"
        return
    package, executable = node.kwargs["package"], node.kwargs["executable"]
    assert executable in executables(package)
    assert node.kwargs["namespace"] == "ssp"
    declared = declared_parameters(package, executable)
    for parameters in node.kwargs.get("parameters", []):
        if isinstance(parameters, dict):
            assert set(parameters) <= declared


def test_the_launch_files_are_found() -> None:
    names = {str(p.relative_to(ROOT)) for p in LAUNCH_FILES}
    assert names >= {
        "ssp_scenario_manager/launch/sil.launch.py",
        "ssp_scenario_manager/launch/track.launch.py",
        "ssp_ot_controller/launch/object_target.launch.py",
        "ssp_monitor/launch/monitor.launch.py",
        "ssp_monitor/launch/page.launch.py",
        "ssp_monitor/launch/view.launch.py",
        "ssp_vla_bridge/launch/vla_bridge.launch.py",
    }


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda p: p.name)
def test_names_in_a_launch_file_exist(path: Path, entities: Callable[[Path], list[Thing]]) -> None:
    found = list(things(entities(path)))
    assert found
    arguments = {t.args[0] for t in found if t.kind == "DeclareLaunchArgument"}
    for thing in found:
        if thing.kind == "Node":
            check_node(thing)
        elif thing.kind == "LaunchConfiguration":
            assert thing.args[0] in arguments
        elif thing.kind == "PathJoinSubstitution":
            share, *parts = thing.args[0]
            assert (ROOT / share.args[0] / Path(*parts)).is_file()


# -- the session ----------------------------------------------------------------------------------


def session(
    entities: Callable[[Path], list[Thing]], out: Path, **given: str
) -> tuple[list[Thing], list[Thing]]:
    """The nodes of a session, and the other actions."""
    made = entities(SIL)
    context = {
        t.args[0]: t.kwargs["default_value"] for t in made if t.kind == "DeclareLaunchArgument"
    }
    context |= {"out": str(out), **given}
    (opaque,) = (t for t in made if t.kind == "OpaqueFunction")
    actions: list[Thing] = opaque.kwargs["function"](context)
    nodes = [a for a in actions if a.kind == "Node"]
    return nodes, [a for a in actions if a.kind != "Node"]


def test_a_session_has_five_nodes_and_waits(
    entities: Callable[[Path], list[Thing]], tmp_path: Path
) -> None:
    out = tmp_path / "run"
    nodes, others = session(entities, out, scenario="vru_crossing", site="north_track", seed="7")
    assert {n.kwargs["executable"] for n in nodes} == {
        *("monitor", "sil_world", "front_camera", "object_target", "scenario_manager"),
    }
    for node in nodes:
        check_node(node)
        executable = node.kwargs["executable"]
        expected: dict[str, str] = {"run_file": str(out / "run.yaml")}
        if executable == "monitor":
            expected["bag_dir"] = str(out / "bag")
        assert node.kwargs["parameters"] == [expected]
    run = load_run(out / "run.yaml")
    assert (run.scenario, run.site, run.seed, run.mode) == (
        "vru_crossing",
        "north_track",
        7,
        "lockstep",
    )
    assert run.run_id == "run"
    assert not (out / "bag").exists()  # the recorder makes it
    (hint,) = others
    assert hint.kind == "LogInfo"
    assert "ros2 action send_goal" in hint.kwargs["msg"]


def test_autorun_sends_the_goal_and_ends_with_it(
    entities: Callable[[Path], list[Thing]], tmp_path: Path
) -> None:
    _, (process,) = session(
        entities, tmp_path / "run", scenario="cut_in", autorun="true", mode="realtime"
    )
    assert process.kind == "ExecuteProcess"
    command = process.kwargs["cmd"]
    assert command[:3] == ["ros2", "action", "send_goal"]
    assert command[-3:-1] == ["/ssp/run_scenario", "ssp_msgs/action/RunScenario"]
    run_file = tmp_path / "run" / "run.yaml"
    assert yaml.safe_load(command[-1]) == {"run_file": str(run_file)}
    assert load_run(run_file).mode == "realtime"
    assert [a.kind for a in process.kwargs["on_exit"]] == ["Shutdown"]


@pytest.mark.parametrize(
    "given", [{"scenario": "overtake"}, {"site": "moon"}, {"seed": "-1"}, {"seed": "many"}]
)
def test_a_wrong_argument_is_named(
    entities: Callable[[Path], list[Thing]], tmp_path: Path, given: dict[str, str]
) -> None:
    (value,) = given.values()
    with pytest.raises(InputError, match=value):
        session(entities, tmp_path / "run", **given)


def test_a_folder_that_holds_something_is_left_alone(
    entities: Callable[[Path], list[Thing]], tmp_path: Path
) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="is not empty"):
        session(entities, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


# -- a live session -------------------------------------------------------------------------------


def on_track(entities: Callable[[Path], list[Thing]], **given: str) -> list[Thing]:
    """Return the actions that the launch file of a live session's host starts."""
    made = entities(TRACK)
    arguments = [t for t in things(made) if t.kind == "DeclareLaunchArgument"]
    context = {t.args[0]: t.kwargs.get("default_value", "") for t in arguments}
    assert set(given) <= set(context)
    (opaque,) = (t for t in made if t.kind == "OpaqueFunction")
    actions: list[Thing] = opaque.kwargs["function"]({**context, **given})
    return actions


@pytest.fixture
def live_file(tmp_path: Path) -> Path:
    run = prepare_run("cut_in", "north_track", tmp_path / "run", seed=None, mode="live")
    path = tmp_path / "run.yaml"
    path.write_text(run.model_dump_json(by_alias=True))
    return path


def test_the_managers_host_and_the_objects_host(
    entities: Callable[[Path], list[Thing]], live_file: Path
) -> None:
    run_file = str(live_file)
    camera = "/camera/image/compressed"
    here = on_track(
        entities,
        run_file=run_file,
        roles="manager,monitor,vut_adapter",
        bag_dir="bag",
        odometry="/ins",
        unit_forward_m="1.2",
        camera_image=camera,
    )
    nodes = {n.kwargs["executable"]: n for n in here if n.kind == "Node"}
    assert set(nodes) == {"scenario_manager", "monitor", "vut_adapter"}
    for node in nodes.values():
        check_node(node)
    remapped = [("vut/front_camera/image/compressed", camera)]
    assert nodes["monitor"].kwargs["remappings"] == remapped
    assert nodes["scenario_manager"].kwargs["remappings"] == remapped
    (adapter,) = nodes["vut_adapter"].kwargs["parameters"]
    assert (adapter["odometry"], adapter["unit_forward_m"]) == ("/ins", 1.2)
    assert sum("ssp doctor --session" in t.kwargs["msg"] for t in here if t.kind == "LogInfo") == 1
    bodies = "ot1=udp://10.0.0.21:9001"
    (targets,) = on_track(entities, run_file=run_file, roles="targets", bodies=bodies)
    check_node(targets)
    (given,) = targets.kwargs["parameters"]
    assert given == {"run_file": run_file, "object_ids": "", "bodies": bodies}


@pytest.mark.parametrize(
    ("given", "field"), [({"roles": "boss"}, "roles"), ({"roles": "monitor"}, "bag_dir")]
)
def test_a_host_without_what_it_needs(
    entities: Callable[[Path], list[Thing]], live_file: Path, given: dict[str, str], field: str
) -> None:
    with pytest.raises(InputError, match=field):
        on_track(entities, run_file=str(live_file), **given)


def test_a_simulated_run_is_no_track_session(
    entities: Callable[[Path], list[Thing]], live_file: Path
) -> None:
    live_file.write_text(live_file.read_text().replace('"live"', '"lockstep"'))
    with pytest.raises(InputError, match="no live session"):
        on_track(entities, run_file=str(live_file), roles="manager")
