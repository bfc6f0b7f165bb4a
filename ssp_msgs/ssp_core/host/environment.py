"""Environment variables of ROS and DDS: which nodes get, and which can't be right.

A variable that somebody set for another purpose must neither lead a session to strangers nor end it
30 s later without a reason. Variables that choose Python's own code are settled by ./ssp before the
first interpreter starts.
"""

from __future__ import annotations

import os
import re
import select
import socket
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from pathlib import Path

from ssp_core.addresses import resolve
from ssp_core.errors import HostError, InputError
from ssp_core.host.shared_memory import check_shared_memory, has_room

# A middleware that isn't installed, moved here by set_middleware_aside.
_ASIDE = "SSP_RMW_IMPLEMENTATION"
# Whatever finds sessions or code of ROS and DDS starts like this.
_PREFIXES = ("ROS_", "RMW_", "RCUTILS_", "FAST", "CYCLONEDDS_", _ASIDE)
# These say where logs go and which distribution is sourced.
_KEPT = {"ROS_DISTRO", "ROS_HOME", "ROS_LOG_DIR", "ROS_PYTHON_VERSION", "ROS_VERSION"}

LARGEST_DOMAIN = 232
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_FILES = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_ENVIRONMENT_FILE",
)
# With any other value ROS can't log, and says so in words of its own.
_TWO_VALUED = (
    "RCUTILS_COLORIZED_OUTPUT",
    "RCUTILS_LOGGING_BUFFERED_STREAM",
    "RCUTILS_LOGGING_USE_STDOUT",
)
# HOST:PORT, or a longer spelling of Fast DDS: a transport, and the address in brackets.
_SERVER = re.compile(
    r"(?:(?:(?:TCP|UDP)v[46]:)?\[(?P<address>[^]]+)\]|(?P<host>[^:[\]]+))(?::(?P<port>[0-9]+))?",
    re.ASCII,
)
_SERVER_PORT = 11811
# A header of RTPS without a submessage: a server reads it and does nothing.
_RTPS_HEADER = b"RTPS\x02\x03" + bytes(14)
# The kernel says after 3 s that a host of the same network doesn't answer.
_UNREACHABLE_S = 3.5
_REFUSED_S = 0.3
_ARP = Path("/proc/net/arp")
_ARP_COMPLETE = 0x2
_ONE_HOST = Path(__file__).parents[1] / "config" / "fastdds_one_host.xml"
_ONE_HOST_UDP = _ONE_HOST.with_name("fastdds_one_host_udp.xml")
# Matrices are small here. Threads for large ones cost each start 40 ms of a processor, and wait for
# each other: in an audit for up to a tenth of its time, where processors are free.
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "1")


def finds_sessions(name: str) -> bool:
    """Tell whether ROS or DDS find sessions, security or code by a variable."""
    return name.startswith(_PREFIXES) and name not in _KEPT


def isolated(env: Mapping[str, str]) -> dict[str, str]:
    """Drop whatever finds sessions or code; keys, proxies and what models need stay."""
    return {name: value for name, value in env.items() if not finds_sessions(name)}


def adopt(env: Mapping[str, str]) -> None:
    """Give this process the ROS variables of a session, and take away those that it hasn't."""
    for name in [name for name in os.environ if finds_sessions(name) and name not in env]:
        del os.environ[name]
    os.environ.update({name: value for name, value in env.items() if finds_sessions(name)})


@contextmanager
def adopted(env: Mapping[str, str]) -> Iterator[None]:
    """Give this process the ROS variables of a session, and its own back afterwards."""
    before = dict(os.environ)
    adopt(env)
    try:
        yield
    finally:
        adopt(before)


def installed_middlewares(env: Mapping[str, str]) -> set[str]:
    """Return the middlewares of the sourced or installed ROS, named as in RMW_IMPLEMENTATION."""
    middlewares = set()
    for prefix in filter(None, env.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        folder = Path(prefix) / "share" / "ament_index" / "resource_index" / "rmw_typesupport"
        if folder.is_dir():
            middlewares |= {file.name for file in folder.iterdir()}
    return middlewares - {"rmw_implementation"}


def set_middleware_aside(env: MutableMapping[str, str]) -> str:
    """Take a middleware that isn't installed out of RMW_IMPLEMENTATION.

    ROS ends a process that merely imports it with such a value. What needs no middleware of others
    goes on without it; a live session is refused all the same (environment_errors).

    Returns:
        The line for people; empty where nothing was taken out.
    """
    middleware = env.get("RMW_IMPLEMENTATION", "")
    if not middleware:
        return ""
    env.pop(_ASIDE, None)
    there = installed_middlewares(env)
    if not there or middleware in there:
        return ""
    env[_ASIDE] = env.pop("RMW_IMPLEMENTATION")
    return (
        f"RMW_IMPLEMENTATION={middleware} is left out: here is {', '.join(sorted(there))} alone. "
        f"A live session is refused with it; `export {_RMW}`, on all hosts, ends this line"
    )


def set_log_folder(env: MutableMapping[str, str]) -> str:
    """Give ROS a folder for its logs where the environment names none that can be made.

    ROS ends a process without one: HOME isn't set in many services and containers.

    Returns:
        The line for people; empty where ROS has its folder.
    """
    setting = ""
    name = next((name for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME") if env.get(name)), None)
    if name is not None:
        setting, folder = env[name], Path(env[name]).absolute()
        there = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
        if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
            return ""
    instead = Path(tempfile.gettempdir()) / f"ros-log-{os.getuid()}"
    env["ROS_LOG_DIR"] = str(instead)
    why = "HOME isn't set" if name is None else f"{name}={setting} can't be written to"
    return f"{why}: ROS writes its logs to {instead}"


def environment_errors(
    env: Mapping[str, str],
    middlewares: Collection[str] = (),
    is_dead: Callable[[str, int], bool] | None = None,
) -> list[InputError]:
    """Find the variables with which no node can start, or none would meet another.

    Args:
        env: variables of the process that starts nodes.
        middlewares: those installed; empty where that isn't known.
        is_dead: says that no process listens at a host and a UDP port; None doesn't ask.

    Returns:
        Each with variable, value and remedy.
    """
    errors = []
    middleware = env.get(_ASIDE) or env.get("RMW_IMPLEMENTATION", "")

    def wrong(name: str, problem: str, remedy: str) -> None:
        value = env.get(name) or middleware
        errors.append(InputError(problem, field=name, value=value, remedy=remedy))

    domain = env.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= LARGEST_DOMAIN):
        problem = f"must be a whole number from 0 to {LARGEST_DOMAIN}"
        wrong("ROS_DOMAIN_ID", problem, "export ROS_DOMAIN_ID=7, the same on all hosts")
    if middleware and middlewares and middleware not in middlewares:
        there = ", ".join(sorted(middlewares))
        remedy = f"export {_RMW}, on all hosts"
        wrong("RMW_IMPLEMENTATION", f"isn't installed here; there is {there}", remedy)
    discovery = env.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if discovery and discovery not in _RANGES:
        problem = f"must be one of {', '.join(_RANGES)}"
        wrong("ROS_AUTOMATIC_DISCOVERY_RANGE", problem, "unset it, or export one of these")
    for name in _FILES:
        if env.get(name) and not Path(env[name]).is_file():
            wrong(name, "there is no such file", f"unset {name}, or name the file by its full path")
    for name in _TWO_VALUED:
        if env.get(name, "") not in ("", "0", "1"):
            wrong(name, "must be 0 or 1", f"unset {name}, or export it as 1")
    for peer in filter(None, (one.strip() for one in env.get("ROS_STATIC_PEERS", "").split(";"))):
        if not _is_resolvable(peer, 0):
            remedy = "correct the address, or unset the variable; between peers stands ;"
            wrong("ROS_STATIC_PEERS", f"{peer} is no known host", remedy)
    _check_security(env, wrong)
    for problem in _server_problems(env.get("ROS_DISCOVERY_SERVER", ""), is_dead):
        remedy = "start it (docs/deployment.md), correct the address, or unset the variable"
        wrong("ROS_DISCOVERY_SERVER", problem, remedy)
    return errors


_RMW = "RMW_IMPLEMENTATION=rmw_fastrtps_cpp"


def _check_security(env: Mapping[str, str], wrong: Callable[[str, str, str], None]) -> None:
    enable = env.get("ROS_SECURITY_ENABLE", "")
    if enable not in ("", "true", "false"):
        # ROS takes every other word for false: nothing would be encrypted, and nothing says so.
        wrong("ROS_SECURITY_ENABLE", "must be the word true or false", "export it as true")
    if enable != "true":
        return
    if env.get("ROS_SECURITY_STRATEGY", "Enforce") not in ("Enforce", "Permissive"):
        problem = "must be Enforce or Permissive"
        wrong("ROS_SECURITY_STRATEGY", problem, "export ROS_SECURITY_STRATEGY=Enforce")
    keystore = env.get("ROS_SECURITY_KEYSTORE", "")
    if not (keystore and (Path(keystore) / "enclaves").is_dir()):
        remedy = "make the keys (docs/deployment.md), or unset ROS_SECURITY_ENABLE"
        name = "ROS_SECURITY_KEYSTORE" if keystore else "ROS_SECURITY_ENABLE"
        wrong(name, "needs ROS_SECURITY_KEYSTORE with a folder enclaves", remedy)


def _server_problems(servers: str, is_dead: Callable[[str, int], bool] | None) -> Iterator[str]:
    """Yield what is wrong with the addresses of discovery servers, HOST:PORT with ; between."""
    for server in filter(None, (one.strip() for one in servers.split(";"))):
        match = _SERVER.fullmatch(server)
        port = int(match["port"] or _SERVER_PORT) if match else 0
        if match is None or not 0 < port < 1 << 16:
            yield f"{server} is no HOST:PORT"
            continue
        host = match["host"] or match["address"]
        if not _is_resolvable(host, port):
            yield f"{host} is no known host"
        elif match["host"] and is_dead is not None and is_dead(host, port):
            yield f"no server listens at {host}:{port}, so no node would find another"


def _is_resolvable(host: str, port: int) -> bool:
    try:
        return bool(resolve(host, port, socket.SOCK_DGRAM))
    except HostError:
        return False


def is_unreachable(host: str, port: int) -> bool:
    """Say whether a host refuses a UDP port, or doesn't exist in its network.

    A host behind a router that says nothing passes for one that listens.
    """
    until_s = time.monotonic() + _UNREACHABLE_S
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((host, port))
            probe.send(_RTPS_HEADER)
            while time.monotonic() < until_s:
                if select.select([probe], [], [], _REFUSED_S)[0]:
                    probe.recv(1 << 16)  # raises what the kernel was told
                    return False
                if not _asks_for(probe.getpeername()[0]):
                    return False
        except OSError:
            return True
    return True


def _asks_for(address: str) -> bool:
    """Say whether the kernel still asks its network for an address."""
    try:
        lines = [line.split() for line in _ARP.read_text().splitlines()[1:]]
        flags = [int(words[2], 16) for words in lines if words[0] == address]
    except (OSError, ValueError, IndexError):
        return False
    return bool(flags) and not any(one & _ARP_COMPLETE for one in flags)


def require_sound(env: Mapping[str, str], *, asks_servers: bool = False) -> None:
    """Refuse an environment with which nodes can't start or meet.

    Args:
        env: variables of the process that starts nodes.
        asks_servers: also asks the discovery servers, which takes up to 3.5 s for one that is gone.

    Raises:
        InputError: names every variable, with its value and what would be right.
    """
    dead = is_unreachable if asks_servers else None
    if errors := environment_errors(env, installed_middlewares(env), dead):
        raise InputError.of_all(errors, "the environment")


def session_environment(domain_id: int, profile: Path | None = None) -> dict[str, str]:
    """Return variables for node processes: loopback only, a domain of their own, our DDS profile.

    What this process was given to find others by is left out: with a discovery server, say, nodes
    meet whatever their domains are, and a simulated session would reach a live one.

    Args:
        domain_id: ROS domain, held by ``free_domain``.
        profile: Fast DDS profile with a large shared-memory segment, None for the shipped one; left
            out where /dev/shm is too small for it (a container's default is 64 MB), since a write
            beyond its end kills the process.

    Raises:
        HostError: /dev/shm can't be written to.
    """
    check_shared_memory()
    env = isolated(os.environ)
    env["ROS_DOMAIN_ID"] = str(domain_id)
    env["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    env["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    env["PYTHONUNBUFFERED"] = "1"
    env.setdefault(*ONE_THREAD)
    if has_room():
        env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile or _ONE_HOST)
    return env


def without_shared_memory(env: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a session for a process that outlives it and needs no large messages.

    A node that is killed may leave a port in shared memory in the middle of a change, and Fast DDS
    then waits for it without end, with Python's lock held, when another takes its participant down.
    Over UDP nothing of a dead node can be waited for. A user's own profile stays.
    """
    if env.get("FASTRTPS_DEFAULT_PROFILES_FILE", str(_ONE_HOST)) != str(_ONE_HOST):
        return dict(env)
    return {
        **env,
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(_ONE_HOST_UDP),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
    }


def live_environment(profile: Path) -> dict[str, str]:
    """Return the variables for the nodes of a live session.

    They keep the ROS domain, the discovery and the DDS profile that this process was started with,
    since others on other hosts share them.

    Args:
        profile: Fast DDS profile for where the environment names none.

    Raises:
        InputError: with these variables no node could start, or none would meet another.
        HostError: /dev/shm can't be written to.
    """
    check_shared_memory()
    require_sound(os.environ, asks_servers=True)
    env = dict(os.environ)
    env["ROS_DOMAIN_ID"] = env.get("ROS_DOMAIN_ID") or "0"
    env.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    if not env.get("FASTRTPS_DEFAULT_PROFILES_FILE"):
        env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
    if env.get("ROS_DISCOVERY_SERVER"):
        # A discovery server tells its clients of nobody that they don't talk to: a second manager,
        # say. A super client hears of everybody.
        env.setdefault("ROS_SUPER_CLIENT", "TRUE")
    env["PYTHONUNBUFFERED"] = "1"
    env.setdefault(*ONE_THREAD)
    return env
