"""The demonstration's plan: commands that exist, in an order that works, from K* to the package."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest

from ssp_core.cli import cli
from ssp_core.files.writing import write_json
from ssp_core.host.environment import ONE_THREAD
from ssp_eval import demo_plan as plan
from ssp_eval.demo import MADE
from ssp_scenario_manager.event_spec.load import load_event, write_event

OUT = Path("out")


def parse(arguments: tuple[str, ...]) -> click.Context:
    """Return the context that the command line makes of the arguments, without running anything.

    Raises:
        click.UsageError: a command or an option doesn't exist.
    """
    context, command, rest = cli.make_context("ssp", list(arguments)), cli, list(arguments)
    while isinstance(command, click.Group):
        name, found, rest = command.resolve_command(context, rest)
        assert found is not None
        command, context = found, found.make_context(name, list(rest), parent=context)
    return context


@pytest.mark.parametrize("scenarios", [plan.DEFAULT_SCENARIOS, plan.SCENARIOS, ("lead_braking",)])
def test_every_step_is_a_command_that_exists(scenarios: tuple[str, ...]) -> None:
    steps = plan.plan_steps(OUT, scenarios)
    for step in steps:
        if step.arguments[0] != "import-video":
            assert parse(step.arguments).params, step.name
    done: set[str] = set()
    for step in steps:
        assert done.issuperset((*step.needs, *step.after)), step.name
        done.add(step.name)
    assert len(done) == len(steps)
    assert [step.name for step in steps if step.session] == [
        *(f"{name}/simulation" for name in scenarios),
        *(f"{name}/physical" for name in scenarios),
    ]


def test_the_models_are_asked_about_twins_of_every_simulation() -> None:
    (evaluate,) = (s for s in plan.plan_steps(OUT, plan.SCENARIOS) if s.name == "evaluate")
    assert parse(evaluate.arguments).params["twins"] is True
    assert {f"{scenario}/twins" for scenario in plan.SCENARIOS} <= set(evaluate.after)


def test_steps_that_have_the_machine_to_themselves_use_all_processes_of_the_demonstration() -> None:
    steps = plan.plan_steps(OUT, plan.SCENARIOS)
    shared = {s.name for s in steps if "--workers" in s.arguments}
    for step in steps:
        if step.name in shared:
            assert parse(step.arguments).params["workers"] == plan.AT_ONCE
    assert shared == {"evaluate", "package", "verify"}


def test_the_evaluation_goes_on_without_a_scenario_that_failed(tmp_path: Path) -> None:
    steps = {step.name: step for step in plan.plan_steps(tmp_path, plan.DEFAULT_SCENARIOS)}
    write_json(plan.audit_folder(tmp_path, "cut_in") / "audit.json", {})
    asked = steps["evaluate"].command()
    assert [word for word in asked if word.endswith("bag")] == [
        str(plan.run_folder(tmp_path, "cut_in", domain) / "bag")
        for domain in ("synthetic", "simulation", "physical")
    ]
    assert not any("vru_crossing" in word for word in asked)
    assert steps["report"].needs == ()
    # Both, since the report can't know of one that nothing was asked about.
    assert parse(steps["report"].arguments).params["expected"] == plan.DEFAULT_SCENARIOS


def test_importing_what_steps_need_starts_no_thread() -> None:
    """They are forked from the process that imported it."""
    steps = plan.plan_steps(OUT, plan.SCENARIOS)
    modules = dict.fromkeys(name for step in steps for name in step.modules)
    code = f"import os, {', '.join(modules)}; print(len(os.listdir('/proc/self/task')))"
    command = [sys.executable, "-P", "-c", code]
    env = {**os.environ, **dict([ONE_THREAD])}
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True, env=env)
    assert done.stdout == "1\n"


def test_what_a_clip_declares_is_taken_from_its_truth(tmp_path: Path) -> None:
    (step,) = (s for s in plan.plan_steps(tmp_path, ["cut_in"]) if s.arguments[0] == "import-video")
    camera = {"hfov_deg": 66.0, "height_m": 1.35, "pitch_down_rad": 0.02}
    speeds = [{"t_s": 0.0, "speed_mps": 11.512}, {"t_s": 0.1, "speed_mps": 9.0}]
    truth = plan.clip_path(tmp_path, "cut_in").with_suffix(".truth.json")
    write_json(truth, {"camera": camera, "ego_speed_mps": speeds})
    event, version = load_event("cut_in")
    write_event(plan.event_path(tmp_path, "cut_in"), event)
    params = parse(tuple(step.command())).params
    assert params["ego_speed"] == 11.51
    assert params["camera_pitch_deg"] == pytest.approx(1.146)
    assert params["event_version"] == version


def test_all_three_domains_are_made_from_the_k_star_that_is_bound_to_the_clip() -> None:
    k_star = str(plan.event_path(OUT, "cut_in"))
    made = {step.name for step in plan.plan_steps(OUT, ["cut_in"]) if k_star in step.arguments}
    assert made == {"cut_in/simulation", "cut_in/task"}


@pytest.mark.parametrize("name", plan.SCENARIOS)
def test_clips_are_those_that_the_events_name(name: str) -> None:
    event = load_event(name)[0]
    assert event.source.generator == plan.GENERATOR


def test_all_that_is_made_is_known_when_it_is_cleared() -> None:
    """A step writes below the folder only into what a later demonstration may remove."""
    for step in plan.plan_steps(OUT, ["cut_in"]):
        for argument in step.arguments:
            path = Path(argument)
            if path.parts[:1] == (OUT.name,) and len(path.parts) > 1:
                assert path.parts[1] in MADE, (step.name, argument)
