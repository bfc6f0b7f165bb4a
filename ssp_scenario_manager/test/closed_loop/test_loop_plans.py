"""The file of a campaign: what is wrong with it is named by its place, and nothing is left."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from ssp_core.errors import HostError, InputError
from ssp_core.host.ray_cluster import ADDRESS
from ssp_scenario_manager.cli.loop import loop
from ssp_scenario_manager.closed_loop.campaigns import seal
from ssp_scenario_manager.closed_loop.campaigns.campaign import run_campaign
from ssp_scenario_manager.closed_loop.campaigns.plan_file import LoopPlan, load_plan

PLAN = {"schema": "ssp.loop/1", "events": ["cut_in"], "starts": 1, "others": 0}
HTTP = {"backend": "http", "url": "http://127.0.0.1:9"}


def plan_with(**changes: Any) -> LoopPlan:
    return LoopPlan.model_validate({**PLAN, **changes})


def refusal_of(tmp_path: Path, changes: dict[str, Any], *options: str) -> InputError:
    """Return the refusal of a plan by the command, which must leave no folder."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump({**PLAN, **changes}))
    out = tmp_path / "out"
    done = CliRunner().invoke(loop, [str(plan), "--out", str(out), *options])
    assert isinstance(done.exception, InputError), done.exception
    assert not out.exists()
    return done.exception


@pytest.mark.parametrize(
    ("changes", "field", "said"),
    [
        ({"events": ["cut_in", "nothing"]}, "events[1]", "no such event"),
        ({"events": ["."]}, "events[0]", "is no compiled folder"),
        ({"events": ["y" * 10_000]}, "events[0]", "no such event"),
        ({"site": "nowhere"}, "site", "no such site"),
        ({"models": "nothing.yaml"}, "models", "can't be read"),
        ({"drivers": [{"driver": "nobody"}]}, "drivers[0]", "is no driver"),
        (
            {"drivers": [{"driver": "aeb", "label": "a", "options": {"ttc_s": -1}}]},
            "drivers[0]",
            "ttc_s: Input should be greater than 0",
        ),
        (
            {
                "drivers": [
                    {"driver": "mine", "options": HTTP},
                    {"driver": "mine", "label": "other", "options": {**HTTP, "url": "x"}},
                ]
            },
            "drivers[1]",
            "is no address of HTTP",
        ),
    ],
)
def test_what_is_wrong_with_a_plan_is_named_by_its_place(
    changes: dict[str, Any], field: str, said: str, tmp_path: Path
) -> None:
    error = refusal_of(tmp_path, changes)
    assert error.file == str(tmp_path / "plan.yaml")
    assert (error.field or "").split(": ")[0] == field
    assert said in str(error)
    assert error.remedy or error.value is not None


def test_a_driver_that_the_command_names_is_no_part_of_the_file(tmp_path: Path) -> None:
    error = refusal_of(tmp_path, {}, "--drive", "nobody")
    assert (error.file, error.field) == (None, "--drive nobody: driver")


def test_events_without_starts_leave_a_folder_that_another_plan_may_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: Any) -> tuple[str, dict[str, Any]]:
        return "off_spec", {"why": "no run-up"}

    monkeypatch.setattr(seal, "_draw_facts", none)
    for seed in (1, 2):
        plan = plan_with(seed=seed)
        with pytest.raises(InputError, match="has 0 critical starts among"):
            seal.draw_starts(plan, tmp_path, 1, lambda _: None)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"drivers": [{"driver": "nobody"}]}, "is no driver"),
        ({"drivers": [{"driver": "aeb", "options": {"ttc_s": 1.0}}]}, "name of a baseline"),
        ({"drivers": [{"driver": "aeb", "options": {"ttc": 1.0}, "label": "a"}]}, "ttc"),
        ({"latencies": ["fixed:0", "zero"]}, "zero stands twice"),
        ({"latencies": ["measured:1", "measured"]}, "measured is given twice"),
        ({"latencies": ["fast"]}, "is no latency"),
        ({"events": ["cut_in", "cut_in"]}, "stands twice"),
    ],
)
def test_a_plan_that_can_not_be_run_is_refused(
    changes: dict[str, Any], why: str, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump({**PLAN, **changes}))
    with pytest.raises(InputError, match=why):
        load_plan(plan)


def test_a_folder_with_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds something else"):
        run_campaign(plan_with(), tmp_path, 1, lambda *_: None, lambda _: None)
    assert [entry.name for entry in tmp_path.iterdir()] == ["notes.txt"]


def test_a_label_hides_no_privilege() -> None:
    plan = plan_with(drivers=[{"driver": "aeb", "options": {"ttc_s": 1.2}, "label": "late_aeb"}])
    assert plan.everybody[-1].display_name == "late_aeb"
    assert plan.everybody[-1].is_privileged


def test_a_measured_latency_is_of_this_machine(tmp_path: Path) -> None:
    plan = plan_with(latencies=["measured"])
    with pytest.raises(InputError, match=r"--engine.*hardware on the driver's card"):
        run_campaign(plan, tmp_path, 1, lambda *_: None, lambda _: None, "ray")


@pytest.mark.programs
def test_a_cluster_that_does_not_answer_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, out = tmp_path / "plan.yaml", tmp_path / "campaign"
    plan.write_text(yaml.safe_dump(PLAN))
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        monkeypatch.setenv(ADDRESS, address)
        said = CliRunner().invoke(loop, [str(plan), "--out", str(out), "--engine", "ray"])
    assert isinstance(said.exception, HostError), said.output
    assert f"no Ray cluster answers at {address}" in str(said.exception)
    assert not out.exists()
