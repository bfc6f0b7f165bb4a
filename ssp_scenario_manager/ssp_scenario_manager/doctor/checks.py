"""The checks of ``ssp doctor``: each gives a finding, none raises for what it finds."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from ssp_core.errors import HostError
from ssp_core.processes import DOMAINS, free_domain

_GB = 1 << 30


class Status(Enum):
    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found, and what to do about it."""

    name: str
    status: Status
    text: str
    remedy: str = ""


# Import name, distribution, and what can't be done without it. FAIL when the session needs it.
_PACKAGES = (
    ("rclpy", "ros-rclpy", "nodes", Status.FAIL),
    ("numpy", "numpy", "everything", Status.FAIL),
    ("cv2", "opencv-python-headless", "camera, video and opencv_baseline", Status.FAIL),
    ("mcap", "mcap", "bags", Status.FAIL),
    ("rosbags", "rosbags", "bags", Status.FAIL),
    ("pydantic", "pydantic", "all files that people write", Status.FAIL),
    ("numba", "numba", "the simulated camera", Status.FAIL),
    ("scipy", "scipy", "tracking controllers", Status.FAIL),
)


def python_version() -> Finding:
    version = platform.python_version()
    good = sys.version_info[:2] in ((3, 11), (3, 12))
    return Finding(
        "python",
        Status.OK if good else Status.FAIL,
        f"{version} on {platform.platform()}, {os.cpu_count()} cores",
        "" if good else "the ROS 2 wheels exist for 3.11 and 3.12; set SSP_PYTHON",
    )


def packages() -> list[Finding]:
    """Every package that is imported somewhere, with its version."""
    findings = []
    for module, distribution, use, severity in _PACKAGES:
        try:
            importlib.import_module(module)
        except ImportError as error:
            findings.append(
                Finding(
                    module, severity, f"can't be imported: {error}", f"needed for {use}; run ./ssp"
                )
            )
            continue
        try:
            version = importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            version = "installed with the system"
        findings.append(Finding(module, Status.OK, version))
    return findings


def interfaces() -> Finding:
    """The generated messages and their type support libraries load."""
    try:
        module = importlib.import_module("ssp_msgs.msg")
        module.ObjectState.__class__.__import_type_support__()
    except (ImportError, OSError, AttributeError, RuntimeError) as error:
        return Finding(
            "ssp_msgs",
            Status.FAIL,
            f"the built messages don't load: {error}",
            "start through ./ssp (it builds them), or `source install/setup.bash`",
        )
    return Finding("ssp_msgs", Status.OK, "messages and type support load")


def sumo() -> list[Finding]:
    findings = []
    try:
        libsumo = importlib.import_module("libsumo")
        findings.append(Finding("libsumo", Status.OK, str(libsumo.getVersion()[1])))
    except ImportError as error:
        findings.append(
            Finding(
                "libsumo",
                Status.FAIL,
                f"can't be loaded: {error}",
                "sudo apt-get install -y libgl1 libxext6 libxrender1 libatomic1",
            )
        )
    netconvert = shutil.which("netconvert") or str(Path(sys.executable).parent / "netconvert")
    try:
        done = subprocess.run(
            [netconvert, "--version"], capture_output=True, text=True, timeout=20, check=False
        )
        version = done.stdout.splitlines()[0] if done.stdout else done.stderr.strip()
        status = Status.OK if done.returncode == 0 else Status.FAIL
        findings.append(
            Finding("netconvert", status, version, "" if status is Status.OK else "run ./ssp")
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        findings.append(Finding("netconvert", Status.FAIL, str(error), "run ./ssp"))
    return findings


def shared_memory() -> Finding:
    """DDS sends camera frames through /dev/shm; each node may take 64 MB there."""
    shm = Path("/dev/shm")
    if not shm.is_dir():
        return Finding(
            "shared memory", Status.WARN, "there is no /dev/shm", "frames go over UDP, slower"
        )
    free_gb = shutil.disk_usage(shm).free / _GB
    segments = len(list(shm.glob("fastrtps_*_el")))
    text = f"{free_gb:.1f} GB free in /dev/shm, {segments} DDS segments"
    if free_gb < 0.5:
        return Finding(
            "shared memory",
            Status.WARN,
            text,
            "the large-segment profile is left out; in Docker use --shm-size=1g",
        )
    return Finding("shared memory", Status.OK, text)


def disk() -> Finding:
    free_gb = shutil.disk_usage(".").free / _GB
    status = Status.OK if free_gb > 2.0 else Status.WARN
    return Finding(
        "disk",
        status,
        f"{free_gb:.1f} GB free here",
        "" if status is Status.OK else "a session writes about 1 MB a second",
    )


def domain() -> Finding:
    try:
        with free_domain() as domain_id:
            return Finding(
                "ROS domain", Status.OK, f"{domain_id} is free ({DOMAINS.start} to 100 are used)"
            )
    except HostError as error:
        return Finding("ROS domain", Status.FAIL, str(error))


@dataclass(frozen=True, slots=True)
class LinkMeasurement:
    """What two processes on this host measured of each other."""

    matched_s: float
    p50_ms: float
    p99_ms: float
    sent: int
    lost: int


def talk(measure_link: Callable[[], LinkMeasurement]) -> list[Finding]:
    """Two processes find each other over DDS and exchange messages."""
    try:
        link = measure_link()
    except HostError as error:
        return [
            Finding(
                "DDS discovery",
                Status.FAIL,
                str(error),
                "is loopback up, and does a firewall block UDP on it? (`ip link show lo`)",
            )
        ]
    return [
        Finding("DDS discovery", Status.OK, f"two processes matched in {link.matched_s:.2f} s"),
        Finding(
            "DDS round trip",
            Status.OK if link.lost == 0 else Status.WARN,
            f"p50 {link.p50_ms:.2f} ms, p99 {link.p99_ms:.2f} ms, {link.lost} of {link.sent} lost",
        ),
    ]


def all_checks(measure_link: Callable[[], LinkMeasurement]) -> list[Finding]:
    """Every check, in the order in which one depends on the other.

    Args:
        measure_link: lets two processes measure the link between them; raises HostError. It is
            called where ROS is found to be installed.
    """
    findings = [python_version(), *packages(), interfaces(), *sumo()]
    findings += [shared_memory(), disk(), domain()]
    ros_works = all(
        f.status is not Status.FAIL for f in findings if f.name in ("rclpy", "ssp_msgs")
    )
    if ros_works:
        findings += talk(measure_link)
    else:
        findings.append(
            Finding("DDS discovery", Status.FAIL, "not tried: rclpy or ssp_msgs is missing")
        )
    return findings
