"""One software-in-the-loop session: ros2 launch ssp_scenario_manager sil.launch.py scenario:=cut_in

The five nodes come up and wait. The run is started with the action /ssp/run_scenario (the command
is printed), or at once with autorun:=true. ``ssp run`` does the same without ros2 launch.
"""

import time
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ssp_core.errors import InputError
from ssp_core.files.writing import write_text
from ssp_scenario_manager.compile.targets.folder import Mode, prepare_run


def _run_file(scenario: str, site: str, seed: str, mode: str, out: str) -> Path:
    """Compile the event and write run.yaml into the run's folder."""
    name = time.strftime(f"run-{Path(scenario).stem}-{Path(site).stem}-%Y%m%d-%H%M%S")
    folder = (Path(out) if out else Path("out") / name).resolve()
    if folder.exists() and any(folder.iterdir()):
        raise InputError("is not empty", file=folder, remedy="name a new folder with out:=")
    if not seed.isdecimal():
        raise InputError("must be a whole number", field="seed", value=seed, remedy="write seed:=1")
    clock: Mode = "realtime" if mode == "realtime" else "lockstep"
    spec = prepare_run(scenario, site, folder, seed=int(seed), mode=clock)
    write_text(folder / "run.yaml", spec.model_dump_json(by_alias=True, indent=1) + "\n")
    return folder / "run.yaml"


def _node(package: str, executable: str, parameters: dict[str, str]) -> Node:
    return Node(
        package=package,
        executable=executable,
        namespace="ssp",
        name=executable,
        output="screen",
        parameters=[parameters] if parameters else [],
    )


def _session(context: LaunchContext) -> list[Node | ExecuteProcess | LogInfo]:
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("scenario", "site", "seed", "mode", "out")
    }
    path = _run_file(**given)
    run = {"run_file": str(path)}
    actions: list[Node | ExecuteProcess | LogInfo] = [
        _node("ssp_monitor", "monitor", {**run, "bag_dir": str(path.parent / "bag")}),
        _node("ssp_ot_controller", "sil_world", run),
        _node("ssp_ot_controller", "front_camera", run),
        _node("ssp_ot_controller", "object_target", run),
        _node("ssp_scenario_manager", "scenario_manager", run),
    ]
    goal = ["ros2", "action", "send_goal", "--feedback", "/ssp/run_scenario"]
    goal += ["ssp_msgs/action/RunScenario", f"{{run_file: '{path}'}}"]
    if LaunchConfiguration("autorun").perform(context).lower() in ("true", "1"):
        actions.append(ExecuteProcess(cmd=goal, output="screen", on_exit=[Shutdown()]))
    else:
        actions.append(LogInfo(msg=f'to start the run: {" ".join(goal[:-1])} "{goal[-1]}"'))
    return actions


def generate_launch_description() -> LaunchDescription:
    """Launch the five nodes of a session in namespace /ssp."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "scenario", default_value="cut_in", description="event: name or file"
            ),
            DeclareLaunchArgument("site", default_value="boulevard", description="name or file"),
            DeclareLaunchArgument("seed", default_value="1", description="of every disturbance"),
            DeclareLaunchArgument(
                "mode", default_value="lockstep", choices=["lockstep", "realtime"]
            ),
            DeclareLaunchArgument(
                "out", default_value="", description="new folder; empty: out/run-SCENARIO-SITE-…"
            ),
            DeclareLaunchArgument(
                "autorun", default_value="false", description="true: run once, then end"
            ),
            OpaqueFunction(function=_session),
        ]
    )
