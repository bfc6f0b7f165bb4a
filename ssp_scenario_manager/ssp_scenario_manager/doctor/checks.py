"""The checks of ``ssp doctor``: each gives a finding, none raises for what it finds."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from ssp_core.carla.acceptance import refusals
from ssp_core.carla.address import CarlaAddress
from ssp_core.carla.client import CarlaServer
from ssp_core.clock import NS_PER_S
from ssp_core.compiled import state_of_core
from ssp_core.errors import HostError, PeerError
from ssp_core.host.domains import DOMAINS, free_domain
from ssp_core.host.environment import (
    environment_errors,
    finds_sessions,
    installed_middlewares,
    is_unreachable,
)
from ssp_core.host.shared_memory import check_shared_memory
from ssp_core.leap_seconds import TABLE_GOOD_UNTIL, leap_seconds, leap_seconds_may_be_old

_GB = 1 << 30


class Status(Enum):
    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check, and the remedy."""

    name: str
    status: Status
    text: str
    remedy: str = ""


def ok(name: str, text: str) -> Finding:
    return Finding(name, Status.OK, text)


def warn(name: str, text: str, remedy: str = "") -> Finding:
    return Finding(name, Status.WARN, text, remedy)


def fail(name: str, text: str, remedy: str = "") -> Finding:
    return Finding(name, Status.FAIL, text, remedy)


# Import name, distribution, and what can't be done without it.
_PACKAGES = (
    ("rclpy", "ros-rclpy", "nodes"),
    ("numpy", "numpy", "everything"),
    ("cv2", "opencv-python-headless", "camera, video and opencv_baseline"),
    ("mcap", "mcap", "bags"),
    ("rosbags", "rosbags", "bags"),
    ("pydantic", "pydantic", "all files that people write"),
    ("numba", "numba", "the simulated camera"),
    ("scipy", "scipy", "plans that models drive, and statistics"),
)


def python_version() -> Finding:
    platform_text = f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    if (3, 11) <= sys.version_info[:2] <= (3, 14):
        return ok("python", platform_text)
    return fail("python", platform_text, "the ROS 2 wheels exist for 3.11 to 3.14; set SSP_PYTHON")


def package(module: str, distribution: str, use: str) -> Finding:
    """Find a package that is imported somewhere, with its version."""
    try:
        importlib.import_module(module)
    except ImportError as error:
        return fail(module, f"can't be imported: {error}", f"needed for {use}; run ./ssp")
    try:
        return ok(module, importlib.metadata.version(distribution))
    except importlib.metadata.PackageNotFoundError:
        return ok(module, "installed with the system")


def carla_server(address: CarlaAddress, map_sha256: str | None) -> Finding:
    """Tell whether a CARLA server would be accepted for a run now; it is asked, and left alone.

    Args:
        address: its host and port.
        map_sha256: hash that its map must have; None: any.
    """
    name = f"carla {address}"
    try:
        with CarlaServer(address) as server:
            facts = server.facts()
    except (HostError, PeerError) as error:
        return fail(name, str(error), "docs/carla.md says how a server is started")
    refused = refusals(facts, map_sha256)
    if refused:
        texts, remedies = ([getattr(r, part) for r in refused] for part in ("text", "remedy"))
        return fail(name, "a run would be refused: " + "; ".join(texts), "; ".join(remedies))
    text = f"a run would be accepted: CARLA {facts.version}, {facts.map_name}, {facts.map_sha256}"
    return ok(name, text)


def interfaces() -> Finding:
    """Check that the generated messages and their type support libraries load."""
    try:
        module = importlib.import_module("ssp_msgs.msg")
        module.ObjectState.__class__.__import_type_support__()
    except (ImportError, OSError, AttributeError, RuntimeError) as error:
        remedy = "start through ./ssp (it builds them), or `source install/setup.bash`"
        return fail("ssp_msgs", f"the built messages don't load: {error}", remedy)
    return ok("ssp_msgs", "messages and type support load")


def compiled_core() -> Finding:
    """Say whether sessions run compiled; either way they do the same."""
    return ok("compiled core", state_of_core())


def libsumo() -> Finding:
    try:
        return ok("libsumo", str(importlib.import_module("libsumo").getVersion()[1]))
    except ImportError as error:
        remedy = "sudo apt-get install -y libgl1 libxext6 libxrender1 libatomic1"
        return fail("libsumo", f"can't be loaded: {error}", remedy)


def netconvert() -> Finding:
    program = shutil.which("netconvert") or str(Path(sys.executable).parent / "netconvert")
    try:
        process = subprocess.run(
            [program, "--version"], capture_output=True, text=True, timeout=20, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return fail("netconvert", str(error), "run ./ssp")
    version = process.stdout.splitlines()[0] if process.stdout else process.stderr.strip()
    if process.returncode != 0:
        return fail("netconvert", version, "run ./ssp")
    return ok("netconvert", version)


def shared_memory() -> Finding:
    """Check /dev/shm, through which DDS sends camera frames; each node may take 64 MB there."""
    shm = Path("/dev/shm")
    if not shm.is_dir():
        return warn("shared memory", "there is no /dev/shm", "frames go over UDP, slower")
    try:
        check_shared_memory()
    except HostError as error:
        return fail("shared memory", "/dev/shm can't be written to", str(error))
    free_gb = shutil.disk_usage(shm).free / _GB
    segments = len(list(shm.glob("fastrtps_*_el")))
    text = f"{free_gb:.1f} GB free in /dev/shm, {segments} DDS segments"
    if free_gb < 0.5:
        remedy = "the large-segment profile is left out; in Docker use --shm-size=1g"
        return warn("shared memory", text, remedy)
    return ok("shared memory", text)


def disk() -> Finding:
    free_gb = shutil.disk_usage(".").free / _GB
    text = f"{free_gb:.1f} GB free here"
    if free_gb > 2.0:
        return ok("disk", text)
    return warn("disk", text, "a session writes about 1 MB a second")


def domain() -> Finding:
    try:
        with free_domain() as domain_id:
            return ok("ROS domain", f"{domain_id} is free ({DOMAINS.start} to 100 are used)")
    except HostError as error:
        return fail("ROS domain", str(error))


# What SSP consists of; another copy of one of them would be another checkout's limits.
_OURS = (
    "ssp_core",
    "ssp_scenario_manager",
    "ssp_ot_controller",
    "ssp_monitor",
    "ssp_vla_bridge",
    "ssp_eval",
)


def environment(
    env: Mapping[str, str], is_dead: Callable[[str, int], bool] = is_unreachable
) -> list[Finding]:
    """Check the variables by which nodes of a live session find each other and their code."""
    name = "environment"
    wrong = environment_errors(env, installed_middlewares(env), is_dead)
    if wrong:
        return [
            fail(name, f"{one.field}={one.value} {one.problem}", one.remedy or "") for one in wrong
        ]
    variables = sorted(one for one in env if finds_sessions(one) and env[one])
    text = ", ".join(f"{one}={env[one]}" for one in variables) or "names no session"
    behind = [one for one in env.get("SSP_PYTHONPATH", "").split(os.pathsep) if one]
    if behind:
        text += f"; behind SSP's own packages: {', '.join(behind)}"
    return [ok(name, f"{text} (a simulated session drops what finds others)")]


def one_checkout(places: Mapping[str, Path]) -> Finding:
    """Check that all packages of SSP come from one checkout or one workspace.

    Args:
        places: the folder that each package was found in.
    """
    roots: dict[Path, list[str]] = {}
    for one, place in places.items():
        roots.setdefault(_root_of(one, place), []).append(one)
    if len(roots) == 1:
        return ok("checkout", str(next(iter(roots))))
    text = "; ".join(f"{', '.join(names)} from {root}" for root, names in roots.items())
    return fail("checkout", text, "unset PYTHONPATH, and source one workspace alone")


def _root_of(name: str, place: Path) -> Path:
    """Return the checkout or workspace that a package's folder lies in."""
    if (place.parent / "package.xml").is_file():  # a checkout: a folder around each package
        return place.parent.parent
    if place.parent.name not in ("site-packages", "dist-packages"):
        return place.parent
    prefix = place.parents[3]  # of lib/python3.x/site-packages
    return prefix.parent if prefix.name in (name, "ssp_msgs") else prefix


def _places() -> dict[str, Path]:
    specs = {name: importlib.util.find_spec(name) for name in _OURS}
    return {
        name: Path(spec.origin).resolve().parent
        for name, spec in specs.items()
        if spec is not None and spec.origin is not None
    }


# Of the package tzdata, by NTP's clock: seconds since 1900, and TAI minus UTC.
_LISTED = Path("/usr/share/zoneinfo/leap-seconds.list")
_NTP_S = 2_208_988_800
_TAI_AHEAD_OF_GPS_S = 19


def leap_seconds_table(utc_ns: int, listed: Path = _LISTED) -> Finding:
    """Check GPS time minus UTC, for ISO 22133; an old table is compared with the host's."""
    name, ours = "leap seconds", leap_seconds(utc_ns)
    if not leap_seconds_may_be_old(utc_ns):
        return ok(name, f"{ours} s, a table good until {TABLE_GOOD_UNTIL}")
    theirs = _listed_seconds(listed, utc_ns)
    if theirs is None:
        return warn(
            name,
            f"{ours} s, by a table that was good until {TABLE_GOOD_UNTIL}",
            "update SSP or tzdata, or compare IERS Bulletin C; only ISO 22133 objects need it",
        )
    if theirs != ours:
        text = f"{ours} s, but {theirs} s by {listed}"
        return fail(name, text, "update SSP: times of ISO 22133 objects are off by the difference")
    return ok(name, f"{ours} s, as {listed} says")


def _listed_seconds(listed: Path, utc_ns: int) -> int | None:
    """Return GPS time minus UTC by the host's list, None if missing, strange or too old."""
    now_s, offset_s = utc_ns // NS_PER_S + _NTP_S, None
    try:
        lines = [line.split() for line in listed.read_text().splitlines() if line.strip()]
        if now_s >= max(int(words[1]) for words in lines if words[0] == "#@"):
            return None
        for words in lines:
            if not words[0].startswith("#") and int(words[0]) <= now_s:
                offset_s = int(words[1]) - _TAI_AHEAD_OF_GPS_S
    except (OSError, ValueError, IndexError):
        return None
    return offset_s


@dataclass(frozen=True, slots=True)
class LinkMeasurement:
    """The measurements that two processes on this host made of each other."""

    matched_s: float
    p50_ms: float
    p99_ms: float
    sent: int
    lost: int


def talk(measure_link: Callable[[], LinkMeasurement]) -> list[Finding]:
    """Check that two processes find each other over DDS and exchange messages."""
    try:
        link = measure_link()
    except HostError as error:
        remedy = "is loopback up, and does a firewall block UDP on it? (`ip link show lo`)"
        return [fail("DDS discovery", str(error), remedy)]
    trip = f"p50 {link.p50_ms:.2f} ms, p99 {link.p99_ms:.2f} ms, {link.lost} of {link.sent} lost"
    return [
        ok("DDS discovery", f"two processes matched in {link.matched_s:.2f} s"),
        (ok if link.lost == 0 else warn)("DDS round trip", trip),
    ]


def all_checks(measure_link: Callable[[], LinkMeasurement]) -> list[Finding]:
    """Do every check, in the order in which one depends on the other.

    Args:
        measure_link: lets two processes measure the link between them; raises HostError. It is
            called where ROS is found to be installed.
    """
    findings = [python_version(), *(package(*one) for one in _PACKAGES), interfaces()]
    findings += [compiled_core(), libsumo(), netconvert(), shared_memory(), disk(), domain()]
    findings += [one_checkout(_places()), *environment(os.environ)]
    findings.append(leap_seconds_table(time.time_ns()))
    if any(f.status is Status.FAIL for f in findings if f.name in ("rclpy", "ssp_msgs")):
        return [*findings, fail("DDS discovery", "not tried: rclpy or ssp_msgs is missing")]
    return findings + talk(measure_link)
