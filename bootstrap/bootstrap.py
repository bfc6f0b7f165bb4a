"""Makes the pip environment: system libraries, .venv, pinned packages, the built workspace.

Runs on the system's Python with the standard library only. Called by ./ssp when something that
the environment was made from has changed; safe to call again after an interruption. With
``--test-tools`` it installs what only the tests need, as `ssp test` does first, with
``--docs-tools`` what only `ssp docs` needs. With ``--ros`` it makes .ros-venv in place of .venv,
beside an installed ROS 2 (README, "On a ROS machine").
"""

from __future__ import annotations

import ctypes
import filecmp
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
ROS_VENV = ROOT / ".ros-venv"
LOG = ROOT / "log" / "bootstrap.log"
SOURCE_DIRS = (
    "ssp_msgs",
    "ssp_scenario_manager",
    "ssp_ot_controller",
    "ssp_monitor",
    "ssp_vla_bridge",
    "ssp_eval",
)
# A package of ROS that isn't on PyPI, and that a ROS machine has: built here, never on that.
EXTRA_DIRS = ("bootstrap/tf2_msgs",)
# Shared libraries that the SUMO wheels load, and the Debian package of each.
SYSTEM_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libXext.so.6": "libxext6",
    "libXrender.so.1": "libxrender1",
    "libatomic.so.1": "libatomic1",
}
# The versions of Python for which the wheels of ROS exist.
OLDEST, NEWEST = (3, 11), (3, 14)
# The tests look at pages in a real browser, under any of these names.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class BootstrapError(Exception):
    """Something on this machine is missing; the message says what and how to get it."""


def step(text: str) -> None:
    print(f"ssp setup: {text}", flush=True)


def run(command: list[str], what: str, env: dict[str, str] | None = None) -> None:
    """Runs a command with its output in the log; a failure shows the log's end."""
    LOG.parent.mkdir(exist_ok=True)
    with LOG.open("ab") as log:
        log.write(f"\n$ {' '.join(command)}\n".encode())
        log.flush()
        result = subprocess.run(command, stdout=log, stderr=log, env=env, check=False)
    if result.returncode != 0:
        tail = LOG.read_text(errors="replace").splitlines()[-25:]
        place = LOG.relative_to(ROOT)
        raise BootstrapError(f"{what} failed; the end of {place}:\n" + "\n".join(tail))


def missing_apt_packages() -> list[str]:
    """Debian packages without which the environment can't be built or SUMO not be loaded."""
    missing = []
    for library, package in SYSTEM_LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(package)
    if shutil.which("c++") is None and shutil.which("g++") is None:
        missing.append("g++")
    if not (Path(sysconfig.get_path("include")) / "Python.h").is_file():
        missing.append(f"python{sys.version_info.major}.{sys.version_info.minor}-dev")
    try:
        import ensurepip  # noqa: F401  (its absence is how Debian ships Python without venv)
        import venv  # noqa: F401
    except ImportError:
        missing.append(f"python{sys.version_info.major}.{sys.version_info.minor}-venv")
    return missing


def install_apt_packages(packages: list[str]) -> None:
    """Installs them as root or through a sudo that asks nothing, else says the one command."""
    if shutil.which("apt-get") is None:
        raise BootstrapError(
            f"missing on this machine: {', '.join(packages)} (Debian's names). There is no apt-get "
            f"here: install their equivalents and run ./ssp again.{rpm_advice(packages)}"
        )
    apt = ["apt-get", "install", "-y", "--no-install-recommends", *packages]
    by_hand = "sudo apt-get update && sudo " + " ".join(apt)
    if os.geteuid() == 0:
        prefix: list[str] = []
    elif subprocess.run(["sudo", "-n", "true"], capture_output=True, check=False).returncode == 0:
        prefix = ["sudo", "-n"]
    else:
        raise BootstrapError(f"missing on this machine: {', '.join(packages)}. Run:\n  {by_hand}")
    step(f"installing system packages: {' '.join(packages)}")
    env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    run([*prefix, "apt-get", "update"], "apt-get update", env)
    run([*prefix, *apt], f"installing {' '.join(packages)} (by hand: {by_hand})", env)


def rpm_advice(packages: list[str]) -> str:
    """Give the command of an RPM distribution, which installs by what a package provides."""
    manager = next((name for name in ("dnf", "zypper") if shutil.which(name)), None)
    if manager is None:
        return ""
    provided = {package: f"'{library}()(64bit)'" for library, package in SYSTEM_LIBRARIES.items()}
    names = [provided.get(package, package).replace("g++", "gcc-c++") for package in packages]
    names = [
        name.removesuffix("-dev") + "-devel" if name.endswith("-dev") else name for name in names
    ]
    wanted = [name for name in names if not name.endswith("-venv")]
    return f" That is:\n  sudo {manager} install {' '.join(wanted)}"


def install_test_tools() -> int:
    """Install what only the tests need: their packages, and a browser."""
    if status := add_lock("test.lock", "the packages of the tests (about 180 MB to download)"):
        return status
    if any(shutil.which(name) for name in BROWSERS):
        return 0
    try:
        install_apt_packages(["chromium"])
    except BootstrapError as error:
        print(f"ssp setup: the tests of pages need a browser: {error}", file=sys.stderr)
        return 1
    return 0


def install_docs_tools() -> int:
    """Install what only the site of the documentation needs."""
    return add_lock("docs.lock", "the packages of the documentation (about 15 MB to download)")


def add_lock(name: str, what: str) -> int:
    """Install a further lock into .venv, unless its packages are there; return the exit status."""
    stamp, wanted = VENV / f"ssp-{name.replace('.', '-')}", ROOT / "bootstrap" / name
    digest = hashlib.sha256(wanted.read_bytes()).hexdigest()
    if not stamp.exists() or stamp.read_text() != digest:
        step(f"installing {what}")
        try:
            install_lock(wanted)
        except BootstrapError as error:
            print(f"ssp setup: {error}", file=sys.stderr)
            return 1
        stamp.write_text(digest)
    return 0


def check_interpreter() -> None:
    if not OLDEST <= sys.version_info[:2] <= NEWEST:
        raise BootstrapError(
            f"Python {sys.version_info.major}.{sys.version_info.minor} is not supported: the ROS 2 "
            "Jazzy wheels exist for 3.11 to 3.14. Run ./ssp, which finds or names one "
            "(SSP_PYTHON=/path/to/python3.13 chooses it)."
        )


def lock_hash() -> str:
    """Hash of what .venv is made from: the two lock files and the interpreter."""
    digest = hashlib.sha256(sys.version.encode())
    for name in ("uv.lock", "requirements.lock"):
        digest.update((ROOT / "bootstrap" / name).read_bytes())
    return digest.hexdigest()


def make_venv() -> Path:
    """Creates .venv with the locked packages, unless it stands already for the same lock.

    The ROS wheels carry a second set of metadata under the ROS names, which `uv pip sync` would
    take for foreign packages and remove: a changed lock therefore makes a new .venv. What was
    built on the old one is removed with it: its files are newer than those of the new wheels, so
    that a build would take them for up to date.
    """
    python = VENV / "bin" / "python"
    made_for = VENV / "ssp-lock"
    if made_for.exists() and made_for.read_text() == lock_hash():
        return python
    step(f"creating .venv (Python {sys.version.split()[0]})")
    for outdated in (VENV, ROOT / "build", ROOT / "install"):
        shutil.rmtree(outdated, ignore_errors=True)
    run([sys.executable, "-m", "venv", str(VENV)], "creating .venv")
    step("installing pinned packages (about 400 MB to download on a first start)")
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run([*pip, "--require-hashes", "-r", str(ROOT / "bootstrap" / "uv.lock")], "installing uv")
    install_lock(ROOT / "bootstrap" / "requirements.lock")
    share_libraries(next((VENV / "lib").glob("python3.*/site-packages")))
    made_for.write_text(lock_hash())
    return python


def install_lock(lock: Path) -> None:
    """Installs a complete list of packages into .venv, each by its version and hash."""
    uv = [str(VENV / "bin" / "uv"), "pip", "install", "--python", str(VENV / "bin" / "python")]
    # Compiled now, every later start of a node is quicker by a second.
    uv += ["--no-deps", "--compile-bytecode", "--require-hashes", "-r", str(lock)]
    run(uv, f"installing bootstrap/{lock.name}", uv_environment())


def uv_environment() -> dict[str, str]:
    """Gives uv the certificates that pip and the system trust; its own list knows no other CA."""
    env = {**os.environ, "UV_SYSTEM_CERTS": "1"}
    if env.get("PIP_CERT"):
        env.setdefault("SSL_CERT_FILE", env["PIP_CERT"])
    return env


def share_libraries(site: Path) -> None:
    """Keeps one copy of each library that several wheels carry: those of SUMO are 230 MB twice."""
    known: dict[tuple[str, int], Path] = {}
    for file in sorted(site.glob("*.libs/*")):
        same = known.setdefault((file.name, file.stat().st_size), file)
        if same is not file and filecmp.cmp(same, file, shallow=False):
            linked = file.with_name(f"{file.name}.linked")
            try:
                os.link(same, linked)
            except OSError:  # a file system without links
                return
            linked.replace(file)


def link_sources() -> None:
    """Puts the source folders on sys.path, so that an edit needs no build, then install/.

    Behind all of them come the entries of the caller's PYTHONPATH, as ./ssp hands them on.
    """
    site = next((VENV / "lib").glob("python3.*/site-packages"))
    lines = [str(ROOT / name) for name in SOURCE_DIRS]
    lines.append(str(ROOT / "install" / "lib" / site.parent.name / "site-packages"))
    lines.append(
        "import os, sys; "
        "sys.path.extend(filter(None, os.environ.get('SSP_PYTHONPATH', '').split(os.pathsep)))"
    )
    (site / "ssp_sources.pth").write_text("\n".join(lines) + "\n")


def build_workspace(python: Path) -> None:
    """colcon build of all packages into install/, with the wheels as the underlay."""
    step("building the ROS 2 workspace with colcon (log/ has the details)")
    env = {
        **os.environ,
        "PATH": f"{VENV / 'bin'}:{os.environ['PATH']}",
        "VIRTUAL_ENV": str(VENV),
        "AMENT_PREFIX_PATH": str(VENV),
        "CMAKE_PREFIX_PATH": str(VENV),
    }
    wheels = ROOT / "bootstrap" / "wheels.cmake"
    # The second takes back what earlier builds kept in their cache.
    cmake = ["-G", "Ninja", f"-DCMAKE_PROJECT_INCLUDE={wheels}"]
    cmake.append("-DCMAKE_PROJECT_TOP_LEVEL_INCLUDES=")
    run_colcon(python, env, (*EXTRA_DIRS, *SOURCE_DIRS), cmake)


def run_colcon(
    python: Path, env: dict[str, str], folders: tuple[str, ...], cmake: list[str]
) -> None:
    """Builds with the colcon beside a Python, which becomes the one of the nodes' scripts."""
    command = [
        str(python.with_name("colcon")),
        "build",
        "--merge-install",
        "--base-paths",
        *folders,
        "--event-handlers",
        "console_direct-",
        "--cmake-args",
        *cmake,
        f"-DPython3_EXECUTABLE={python}",
        f"-DPYTHON_EXECUTABLE={python}",
        "-DBUILD_TESTING=OFF",
    ]
    os.chdir(ROOT)
    # colcon's own choice ends in -l, which all but stops a build while others use the machine.
    jobs = {"MAKEFLAGS": f"-j{os.cpu_count() or 1}"}
    run(command, "colcon build", {**jobs, **env, "COLCON_LOG_PATH": str(ROOT / "log")})


def make_ros_venv() -> Path:
    """Creates .ros-venv: ROS from the sourced distribution, all else from the lock.

    It sees the system's packages, since ROS needs them. pip takes what is there for satisfied, such
    as a pydantic 1 of the system's; uv looks into the virtual environment alone and installs all of
    runtime.in. Its own colcon writes its Python into the nodes' scripts, its own ros2 runs launch
    files on it; the system's would take the system's Python for both.
    """
    python = ROS_VENV / "bin" / "python"
    run([sys.executable, "-m", "venv", "--system-site-packages", str(ROS_VENV)], "creating it")
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run([*pip, "--require-hashes", "-r", str(ROOT / "bootstrap" / "uv.lock")], "installing uv")
    lock, wanted = ROOT / "bootstrap" / "requirements.lock", ROOT / "bootstrap" / "runtime.in"
    uv = [str(ROS_VENV / "bin" / "uv"), "pip", "install", "--python", str(python)]
    uv += ["-c", str(lock), "-r", str(wanted), "colcon-common-extensions"]
    run(uv, f"installing {wanted.name}", uv_environment())
    ros2 = ROS_VENV / "bin" / "ros2"
    ros2.write_text(f"#!{python}\nimport sys\n\nfrom ros2cli.cli import main\n\nsys.exit(main())\n")
    ros2.chmod(0o755)
    return python


def set_up_ros_machine() -> int:
    """Makes .ros-venv and builds the workspace into install/ on top of the sourced ROS."""
    started = time.monotonic()
    try:
        check_interpreter()
        if not os.environ.get("ROS_DISTRO"):
            raise BootstrapError("no ROS is sourced. Run first: source /opt/ros/jazzy/setup.bash")
        if VENV.exists():
            raise BootstrapError("./ssp has built install/ of this folder for .venv: take another")
        missing = missing_apt_packages() + ([] if shutil.which("make") else ["make"])
        if missing:
            install_apt_packages(missing)
        step("creating .ros-venv with pinned packages (about 500 MB to download)")
        python = make_ros_venv()
        step("building the ROS 2 workspace with colcon (log/ has the details)")
        path = f"{ROS_VENV / 'bin'}:{os.environ['PATH']}"
        env = {**os.environ, "PATH": path, "VIRTUAL_ENV": str(ROS_VENV)}
        run_colcon(python, env, SOURCE_DIRS, [])
    except BootstrapError as error:
        print(f"ssp setup: {error}", file=sys.stderr)
        return 1
    step(f"ready after {time.monotonic() - started:.0f} s")
    return 0


def main(fingerprint: str) -> int:
    started = time.monotonic()
    try:
        check_interpreter()
        missing = missing_apt_packages()
        if missing:
            install_apt_packages(missing)
        stamp = VENV / "ssp-ready"
        stamp.unlink(missing_ok=True)
        python = make_venv()
        link_sources()
        build_workspace(python)
        stamp.write_text(fingerprint + "\n")
    except BootstrapError as error:
        print(f"ssp setup: {error}", file=sys.stderr)
        return 1
    step(f"ready after {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    asked = {
        "--test-tools": install_test_tools,
        "--docs-tools": install_docs_tools,
        "--ros": set_up_ros_machine,
    }
    sys.exit(asked[sys.argv[1]]() if sys.argv[1] in asked else main(sys.argv[1]))
