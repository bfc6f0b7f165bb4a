"""Variables of ROS and DDS: dropped for isolated sessions, checked before live ones."""

import os
import socket
from pathlib import Path

import pytest

from ssp_core.errors import HostError, InputError
from ssp_core.host import shared_memory
from ssp_core.host.environment import (
    adopted,
    environment_errors,
    installed_middlewares,
    is_unreachable,
    isolated,
    live_environment,
    require_sound,
    session_environment,
    set_log_folder,
    set_middleware_aside,
)

# What finds sessions, security or code of others.
FINDERS = {
    "ROS_DOMAIN_ID": "abc",
    "ROS_DISCOVERY_SERVER": "127.0.0.1:11811",
    "ROS_SUPER_CLIENT": "TRUE",
    "ROS_STATIC_PEERS": "10.0.0.1",
    "ROS_LOCALHOST_ONLY": "0",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    "ROS_SECURITY_ENABLE": "true",
    "ROS_SECURITY_KEYSTORE": "/nowhere",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "RMW_FASTRTPS_USE_QOS_FROM_XML": "1",
    "FASTRTPS_DEFAULT_PROFILES_FILE": "/nowhere.xml",
    "FASTDDS_DEFAULT_PROFILES_FILE": "/nowhere.xml",
    "FASTDDS_ENVIRONMENT_FILE": "/nowhere.json",
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    "CYCLONEDDS_URI": "<x/>",
    "RCUTILS_LOGGING_USE_STDOUT": "abc",
}
OTHERS = {
    "OPENAI_API_KEY": "secret",
    "HTTPS_PROXY": "http://proxy:3128",
    "NO_PROXY": "localhost",
    "CUDA_VISIBLE_DEVICES": "0",
    "HF_HOME": "/models",
    "SSL_CERT_FILE": "/etc/ca.pem",
    "ROS_LOG_DIR": "/var/log/ros",
    "ROS_DISTRO": "jazzy",
}


def test_an_isolated_session_is_told_of_no_other() -> None:
    assert isolated(FINDERS | OTHERS) == OTHERS


def test_ros_has_a_folder_for_its_logs(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    for env in ({"HOME": "/x/y", "ROS_LOG_DIR": str(tmp_path / "a/b")}, {"HOME": str(tmp_path)}):
        before = dict(env)
        assert (set_log_folder(env), env) == ("", before)
    for env, why in (
        ({}, "HOME isn't set"),
        ({"HOME": ""}, "HOME isn't set"),
        ({"HOME": str(blocked / "home")}, f"HOME={blocked / 'home'} can't be written to"),
    ):
        told = set_log_folder(env)
        assert told == f"{why}: ROS writes its logs to {env['ROS_LOG_DIR']}"
        assert Path(env["ROS_LOG_DIR"]).parent.is_dir()


def test_the_nodes_of_a_simulated_session_find_only_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (FINDERS | OTHERS).items():
        monkeypatch.setenv(name, value)
    env = session_environment(42)
    assert OTHERS.items() <= env.items()
    found = {name: env[name] for name in FINDERS if name in env}
    profile = found.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    assert profile is None or Path(profile).name == "fastdds_one_host.xml"  # None: no room for it
    assert found == {
        "ROS_DOMAIN_ID": "42",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    }


def test_this_process_joins_a_session_and_gets_its_own_variables_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in FINDERS.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    with adopted(session_environment(42)):
        assert os.environ["ROS_DOMAIN_ID"] == "42"
        assert "ROS_DISCOVERY_SERVER" not in os.environ
        assert "ROS_SECURITY_ENABLE" not in os.environ
    assert dict(os.environ) == before


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "abc", "0 to 232"),
        ("ROS_DOMAIN_ID", "233", "0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "0 to 232"),
        ("ROS_DOMAIN_ID", "4²", "0 to 232"),
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "there is rmw_fastrtps_cpp"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "LOCALHOST"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/nowhere.xml", "no such file"),
        ("FASTDDS_ENVIRONMENT_FILE", "/nowhere.json", "no such file"),
        ("ROS_SECURITY_ENABLE", "1", "true or false"),
        ("ROS_SECURITY_ENABLE", "true", "ROS_SECURITY_KEYSTORE"),
        ("ROS_DISCOVERY_SERVER", "127.0.0.1:port", "HOST:PORT"),
        ("ROS_DISCOVERY_SERVER", "127.0.0.1:70000", "HOST:PORT"),
        ("ROS_DISCOVERY_SERVER", ";no.such.host.invalid:11811", "no known host"),
        ("ROS_DISCOVERY_SERVER", "TCPv4:[127.0.0.1]:99999", "HOST:PORT"),
        ("ROS_DISCOVERY_SERVER", "UDPv4:[no.such.host.invalid]:11811", "no known host"),
        ("ROS_DISCOVERY_SERVER", "[::1]:0", "HOST:PORT"),
        ("ROS_STATIC_PEERS", "127.0.0.1;no.such.host.invalid", "no known host"),
        ("RCUTILS_LOGGING_USE_STDOUT", "abc", "0 or 1"),
        ("RCUTILS_COLORIZED_OUTPUT", "true", "0 or 1"),
    ],
)
def test_a_wrong_variable_is_named_with_value_and_remedy(name: str, value: str, words: str) -> None:
    (error,) = environment_errors({name: value}, {"rmw_fastrtps_cpp"})
    assert error.field == name
    assert error.value == value
    assert error.remedy
    assert words in str(error)


def test_what_is_right_is_let_through(tmp_path: Path) -> None:
    (tmp_path / "enclaves").mkdir()
    profile = tmp_path / "profile.xml"
    profile.touch()
    env = {
        "ROS_DOMAIN_ID": "232",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "ROS_DISCOVERY_SERVER": (
            ";127.0.0.1:11811;127.0.0.2;[127.0.0.1]:11811;TCPv4:[127.0.0.1]:42100;UDPv6:[::1]:11811"
        ),
        "ROS_STATIC_PEERS": "127.0.0.1; 10.0.0.1;",
        "RCUTILS_COLORIZED_OUTPUT": "0",
        "RCUTILS_LOGGING_USE_STDOUT": "1",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
        **OTHERS,
    }
    assert environment_errors(env, {"rmw_fastrtps_cpp"}, lambda *_: False) == []
    assert environment_errors(dict.fromkeys(FINDERS, "")) == []


def test_a_middleware_that_is_not_there_is_set_aside_and_a_live_session_refused(
    tmp_path: Path,
) -> None:
    there = tmp_path / "share" / "ament_index" / "resource_index" / "rmw_typesupport"
    there.mkdir(parents=True)
    (there / "rmw_fastrtps_cpp").touch()
    env = {"AMENT_PREFIX_PATH": str(tmp_path), "RMW_IMPLEMENTATION": "rmw_of_nobody"}
    line = set_middleware_aside(env)
    assert "RMW_IMPLEMENTATION=rmw_of_nobody" in line
    assert "rmw_fastrtps_cpp alone" in line
    assert "RMW_IMPLEMENTATION" not in env
    # A command of a command takes over what was set aside, and says nothing more of it.
    assert set_middleware_aside(env) == ""
    with pytest.raises(InputError, match=r"rmw_of_nobody.*export RMW_IMPLEMENTATION=rmw_fastrtps"):
        require_sound(env)
    require_sound(isolated(env))
    env["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    assert set_middleware_aside(env) == ""
    require_sound(env)


def test_the_middleware_of_the_wheels_is_found() -> None:
    if "AMENT_PREFIX_PATH" not in os.environ:
        pytest.skip("no ROS is set up")
    assert "rmw_fastrtps_cpp" in installed_middlewares(os.environ)


def test_a_dead_discovery_server_is_known_at_once_and_a_living_one_too() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
        assert not is_unreachable("127.0.0.1", port)
    assert is_unreachable("127.0.0.1", port)
    env = {"ROS_DISCOVERY_SERVER": f"127.0.0.1:{port}"}
    with pytest.raises(InputError, match=r"no server listens at .*start it"):
        require_sound(env, asks_servers=True)


def test_no_live_node_is_started_with_a_wrong_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in FINDERS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "HERE")
    with pytest.raises(InputError) as caught:
        live_environment(Path("/x/hosts.xml"))
    assert "ROS_DOMAIN_ID" in str(caught.value)
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" in str(caught.value)


def test_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_STATIC_PEERS", "10.0.0.1")
    monkeypatch.setenv("SOMETHING", "kept")
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    env = session_environment(42)
    assert env["ROS_DOMAIN_ID"] == "42"
    assert env["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "ROS_STATIC_PEERS" not in env
    assert env["SOMETHING"] == "kept"
    assert "ROS_DOMAIN_ID" not in os.environ or os.environ["ROS_DOMAIN_ID"] != "42"


@pytest.mark.parametrize(("free_mb", "used"), [(63, False), (512, False), (513, True)])
def test_the_profile_needs_room_in_shared_memory(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, free_mb: int, used: bool
) -> None:
    class Usage:
        free = free_mb << 20

    monkeypatch.setattr(shared_memory, "_SHM", tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda _: Usage)
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    env = session_environment(42, tmp_path / "profile.xml")
    assert ("FASTRTPS_DEFAULT_PROFILES_FILE" in env) == used


def test_shared_memory_that_is_read_only_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # A file system that is mounted read-only says no to everybody, root included.
    monkeypatch.setattr(shared_memory, "_SHM", tmp_path)
    monkeypatch.setattr("os.access", lambda path, mode: not (path == tmp_path and mode & os.W_OK))
    with pytest.raises(HostError, match=r"must be writable.*--in-process"):
        session_environment(42)
    with pytest.raises(HostError, match="must be writable"):
        live_environment(tmp_path / "profile.xml")


def test_without_shared_memory_nodes_talk_over_udp(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shared_memory, "_SHM", tmp_path / "none")
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in session_environment(42)
