"""The processes that `ssp run --mode live` starts, and the runs that it refuses."""

from __future__ import annotations

import json
import os
import shlex
import socket
import subprocess
from pathlib import Path
from typing import Any

import click
import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.model import Fault, LinkDisturbance, RunSpec, load_run
from ssp_core.run_file.values import SiteDatum
from ssp_scenario_manager.cli.doctor import doctor
from ssp_scenario_manager.compile.changes import differences
from ssp_scenario_manager.compile.task import as_live, check_live
from ssp_scenario_manager.run.over_dds.live import LiveSetup, describe, doctor_command


def options(**given: Any) -> dict[str, Any]:
    return {
        "bodies": (),
        "odometry": None,
        "navsat": None,
        "heading": None,
        "velocity": None,
        "least_fix": None,
        "unit": None,
        "remappings": (),
        "wait": False,
        "start_at_once": False,
        "declared": None,
        **given,
    }


@pytest.fixture
def noisy(run: RunSpec) -> RunSpec:
    """A run with the disturbances of a stand-in site."""
    return run.model_copy(
        update={
            "domain": "physical",
            "disturbance": LinkDisturbance(state_loss=0.01),
            "disturbances": {"ot1": LinkDisturbance(position_noise_m=0.1)},
        }
    )


def test_real_objects_are_left_alone(noisy: RunSpec) -> None:
    live = as_live(noisy)
    assert live.mode == "live"
    assert live.disturbance_of("ot1") == live.disturbance_of("vut") == LinkDisturbance()
    assert live.traffic == []
    check_live(live)
    # What a simulated world would add is no change on site; anything else is.
    assert differences(noisy, live) == []
    quicker = live.model_copy(update={"step_s": 0.01})
    assert [d.field for d in differences(noisy, quicker)] == ["step_s"]


def test_a_simulated_site_is_no_track(run: RunSpec) -> None:
    with pytest.raises(InputError, match="no proving ground"):
        as_live(run.model_copy(update={"domain": "simulation"}))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("disturbance", {"state_loss": 0.01}),
        ("disturbances", {"ot1": {"position_noise_m": 0.1}}),
        ("faults", [{"kind": "position_jump", "target": "ot1", "at_s": 1.0, "value": 2.0}]),
        ("faults", [{"kind": "vut_stop", "target": "vut", "at_s": 1.0}]),
    ],
)
def test_a_live_run_file_with_faults_of_objects_is_refused(
    run: RunSpec, tmp_path: Path, field: str, value: Any
) -> None:
    mapping = run.model_dump(mode="json", by_alias=True)
    mapping |= {"disturbance": {}, "disturbances": {}, "faults": [], "traffic": [], "mode": "live"}
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps(mapping))
    load_run(path)
    path.write_text(json.dumps({**mapping, field: value}))
    with pytest.raises(InputError, match="live"):
        load_run(path)


def test_faults_of_processes_may_be_rehearsed(noisy: RunSpec) -> None:
    live = as_live(noisy)
    kill = Fault(kind="kill", target="object_target", at_s=1.0)
    check_live(live.model_copy(update={"faults": [kill]}))
    jump = Fault(kind="position_jump", target="ot1", at_s=1.0)
    with pytest.raises(InputError, match="position_jump"):
        check_live(live.model_copy(update={"faults": [jump]}))


def test_the_nodes_of_a_host(tmp_path: Path) -> None:
    setup = LiveSetup.of_options(
        "live",
        options(
            bodies=("ot2=mirror", "ot1=udp://10.0.0.21:9001"), odometry="/ins", unit=(1.2, 0.0, 0.1)
        ),
    )
    assert setup is not None
    nodes = setup.parameters(tmp_path / "run.yaml", tmp_path / "bag")
    assert list(nodes) == ["monitor", "object_target", "vut_adapter", "scenario_manager"]
    assert nodes["object_target"]["object_ids"] == "ot1,ot2"
    assert nodes["object_target"]["bodies"] == "ot1=udp://10.0.0.21:9001,ot2=mirror"
    assert nodes["vut_adapter"]["unit_forward_m"] == 1.2
    assert nodes["vut_adapter"]["unit_yaw_left_rad"] == 0.1
    gnss = {"navsat": "/fix", "heading": "/imu", "velocity": "/vel", "least_fix": "sbas"}
    places = LiveSetup.of_options("live", options(**gnss, unit=(1.2, 0.0, 0.1)))
    assert places is not None
    adapter = places.parameters(tmp_path / "run.yaml", tmp_path / "bag")["vut_adapter"]
    assert adapter.items() >= gnss.items()
    assert (adapter["unit_forward_m"], "odometry" in adapter) == (1.2, False)
    elsewhere = LiveSetup.of_options("live", options())
    assert elsewhere is not None
    assert list(elsewhere.parameters(tmp_path, tmp_path)) == ["monitor", "scenario_manager"]


def test_a_body_is_reached_over_ipv6_too() -> None:
    setup = LiveSetup.of_options("live", options(bodies=("ot1=udp://[fe80::1]:9001",)))
    assert setup is not None
    assert setup.bodies == {"ot1": "udp://[fe80::1]:9001"}


@pytest.mark.parametrize(
    ("mode", "given", "told"),
    [
        ("lockstep", {"bodies": ("ot1=mirror",)}, "--body: only with --mode live"),
        ("realtime", {"wait": True}, "--wait: only with --mode live"),
        ("realtime", {"start_at_once": True}, "--start-at-once: only with --mode live"),
        ("live", {"wait": True, "start_at_once": True}, "--start-at-once for none"),
        ("live", {"unit": (1.0, 0.0, 0.0)}, "--odometry"),
        ("live", {"odometry": "/a", "navsat": "/b", "heading": "/c"}, "has one GNSS/INS"),
        ("live", {"odometry": "/a", "least_fix": "fix"}, "has one GNSS/INS"),
        ("live", {"navsat": "/b"}, "--navsat and --heading go together"),
        ("live", {"heading": "/b"}, "--navsat and --heading go together"),
        ("live", {"velocity": "/b"}, "--navsat and --heading go together"),
        ("lockstep", {"least_fix": "fix"}, "--least-fix: only with --mode live"),
        ("live", {"bodies": ("ot1",)}, "write ID="),
        ("live", {"bodies": ("ot1=mirror,ot2=mirror",)}, "write ID="),
        ("live", {"bodies": ("ot1=udp://a:70000",)}, "is no body"),
        ("live", {"bodies": ("ot1=udp://fe80::1:9001",)}, "is no body"),
        ("live", {"bodies": ("ot1=iso22133://h?unknown=1",)}, "is no body"),
        ("live", {"bodies": ("ot1=iso22133://h:1",)}, "is no body"),
        ("live", {"bodies": ("ot1=mirror", "ot1=udp://a:1")}, "has a body already"),
        ("live", {"remappings": ("a:b",)}, "OURS:=THEIRS"),
        ("live", {"remappings": ("__node:=b",)}, "OURS:=THEIRS"),
    ],
)
def test_wrong_options_are_named(mode: str, given: dict[str, Any], told: str) -> None:
    with pytest.raises(click.UsageError, match=told):
        LiveSetup.of_options(mode, options(**given))


def test_a_simulated_run_has_no_setup() -> None:
    assert LiveSetup.of_options("lockstep", options()) is None


def test_what_people_are_told(run: RunSpec, tmp_path: Path) -> None:
    setup = LiveSetup({"ot9": "mirror"})
    with pytest.raises(InputError, match="ot9"):
        setup.check(run)
    env = {
        "ROS_DOMAIN_ID": "7",
        "ROS_DISCOVERY_SERVER": "10.0.0.1:11811",
        "FASTRTPS_DEFAULT_PROFILES_FILE": "/x/hosts.xml",
    }
    text = "\n".join(describe(LiveSetup({}), run, tmp_path / "run.yaml", env))
    for part in ("domain 7", "10.0.0.1:11811", "hosts.xml", "object_target of ot1", "/ssp/vut/sta"):
        assert part in text
    waived = LiveSetup({"ot1": "iso22133://10.0.0.7?waive=A. Tester&report=r.json"})
    text = "\n".join(describe(waived, run, tmp_path / "run.yaml", env))
    assert "A. Tester lets ot1 be armed whatever its probe report lacks" in text


def test_bodies_on_hosts_without_an_address_are_named(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    placed = run.model_copy(update={"datum": SiteDatum(latitude_deg=57.8, longitude_deg=12.8)})
    for address in ("udp://localhost:9", "udp://[::1]:9", "iso22133://127.0.0.1", "mirror"):
        LiveSetup({"ot1": address}).check(placed)
    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    for address in ("udp://nohost.invalid:9", "iso22133://nohost.invalid?waive=A. Tester"):
        with pytest.raises(InputError) as caught:
            LiveSetup({"ot1": address}).check(placed)
        assert (caught.value.field, caught.value.value) == ("--body", f"ot1={address}")
        assert caught.value.problem == "'nohost.invalid' has no address: Name or service not known"
        assert caught.value.remedy


def test_places_on_the_earth_need_a_site_that_lies_somewhere(run: RunSpec, tmp_path: Path) -> None:
    setup = LiveSetup({}, {"navsat": "/fix", "heading": "/imu"})
    with pytest.raises(InputError, match="site's position is unknown") as caught:
        setup.check(run)
    assert caught.value.field == "datum"
    datum = SiteDatum(latitude_deg=57.8, longitude_deg=12.8)
    setup.check(run.model_copy(update={"datum": datum}))
    env = {"ROS_DOMAIN_ID": "7", "FASTRTPS_DEFAULT_PROFILES_FILE": "/x/hosts.xml"}
    assert "--navsat /fix" in describe(setup, run, tmp_path / "run.yaml", env)[-1]


@pytest.mark.parametrize(
    "given",
    [
        {"ROS_DISCOVERY_SERVER": "10.0.0.1:11811;10.0.0.2:11811"},
        {"ROS_STATIC_PEERS": "10.0.0.1;10.0.0.2", "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
        {
            "ROS_SECURITY_ENABLE": "true",
            "ROS_SECURITY_KEYSTORE": "/etc/our keys",
            "ROS_SECURITY_STRATEGY": "Enforce",
        },
        {"FASTRTPS_DEFAULT_PROFILES_FILE": "/etc/our profile.xml", "RMW_IMPLEMENTATION": "rmw_a"},
    ],
)
def test_the_doctors_command_can_be_pasted_into_any_shell(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given: dict[str, str]
) -> None:
    monkeypatch.setenv("SSP_ROOT", str(tmp_path / "our tree"))
    monkeypatch.setenv("PATH", str(tmp_path))
    env = {"ROS_DOMAIN_ID": "7", **given}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    setup = LiveSetup({}, {"odometry": "/ins/odometry"}, remappings=("a/b:=/c d",))
    run_file = tmp_path / "a session" / "run.yaml"
    line = doctor_command(setup, run_file, env)
    done = subprocess.run(
        ["/bin/sh", "-c", line.replace(" doctor ", " ")],
        env={"PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert f"{tmp_path}/our tree/ssp" in done.stderr  # which isn't there
    words = shlex.split(line)
    own = words.index(f"{tmp_path}/our tree/ssp")
    assert words[:own] == sorted(f"{k}={v}" for k, v in env.items())
    assert words[own + 1] == "doctor"
    params = doctor.make_context("doctor", words[own + 2 :]).params
    assert params["run_file"] == run_file
    assert (params["odometry"], params["remappings"]) == ("/ins/odometry", ("a/b:=/c d",))


def test_the_doctors_command_leaves_out_what_each_command_sets_for_itself(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FASTDDS_ENVIRONMENT_FILE", "dds.json")
    monkeypatch.setenv("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{message}")
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.chdir(tmp_path)
    env = {**os.environ, "ROS_DOMAIN_ID": "0", "FASTRTPS_DEFAULT_PROFILES_FILE": "/s/fastdds.xml"}
    words = shlex.split(doctor_command(LiveSetup({}, {}), tmp_path / "run.yaml", env))
    assert f"FASTDDS_ENVIRONMENT_FILE={tmp_path}/dds.json" in words
    assert "ROS_DOMAIN_ID=0" in words
    assert not any(word.startswith(("FASTRTPS_", "RCUTILS_")) for word in words)


def test_a_live_run_asks_unless_it_is_told_to_start_at_once() -> None:
    asks, waits = (LiveSetup.of_options("live", options(wait=wait)) for wait in (False, True))
    assert asks == waits
    assert asks is not None
    assert not asks.start_at_once
    at_once = LiveSetup.of_options("live", options(start_at_once=True))
    assert at_once is not None
    assert at_once.start_at_once
