"""The launcher: whose code runs, and what it says where no Python is found."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ssp_eval.demo import follow
from ssp_eval.demo_plan import Step

ROOT = Path(__file__).resolve().parent.parent
LAUNCHER = ROOT / "ssp"
PYTHON_SH = ROOT / "bootstrap" / "python.sh"
# Programs that python.sh may call, beside what a case gives.
TOOLS = ("bash", "head", "env", "cat")


def launch(
    variables: dict[str, str], *arguments: str, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [LAUNCHER, *arguments],
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def test_a_folder_that_was_deleted_under_the_shell_is_named(tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir()
    done = subprocess.run(
        ["bash", "-c", f'cd "{here}" && rmdir "{here}" && exec "{LAUNCHER}" --help'],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert f"ssp: the folder {here} doesn't exist any more; `cd` to one that does" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("package", ["ssp_core", "ssp_msgs", "ssp_eval"])
def test_code_of_another_checkout_is_refused(tmp_path: Path, package: str) -> None:
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").touch()
    done = launch({"PYTHONPATH": f"/nowhere:{tmp_path}"}, "env")
    assert done.returncode == 2
    for words in ("PYTHONPATH", str(tmp_path), package, "unset PYTHONPATH"):
        assert words in done.stderr
    assert done.stdout == ""


@pytest.fixture
def astray(tmp_path: Path) -> Path:
    """A folder to stand in with packages of ours, of the lock and of Python, none of which runs."""
    folder = tmp_path / "astray"
    for name in ("ssp_core", "ssp_scenario_manager", "click", "yaml", "json", "multiprocessing"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("raise SystemExit(f'{__file__} ran')\n")
    return folder


def test_no_code_of_the_working_folder_runs(astray: Path) -> None:
    done = launch({}, "spec", "check", "cut_in", folder=astray)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "cut_in" in done.stdout


def test_no_code_of_the_working_folder_runs_in_workers(astray: Path, tmp_path: Path) -> None:
    runs = ("run", "cut_in", "--site", "north_track", "--in-process", "--runs", "2")
    done = launch({}, *runs, "--jobs", "2", "--out", str(tmp_path / "runs"), folder=astray)
    assert done.returncode == 0, done.stdout + done.stderr


def test_no_code_of_the_working_folder_runs_in_a_step_of_the_demo(
    astray: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(astray)
    monkeypatch.setenv("SSP_ASTRAY", "1")  # with other variables steps have a process of their own
    step = Step("check", "check", ("spec", "check", "cut_in"))
    assert follow([step], tmp_path, lambda *_: None, lambda _: None) == []
    assert "cut_in" in (tmp_path / "check.log").read_text().splitlines()[1]


def test_other_entries_come_behind_and_ones_own_workspace_is_no_other(tmp_path: Path) -> None:
    ours = ROOT / "ssp_msgs"
    done = launch({"PYTHONPATH": f"{tmp_path}:{ours}::{tmp_path}", "SSP_PYTHONPATH": ""}, "env")
    assert done.returncode == 0, done.stderr
    assert "unset PYTHONHOME PYTHONPLATLIBDIR PYTHONPATH" in done.stdout
    assert f"export SSP_PYTHONPATH={tmp_path}\n" in done.stdout


@pytest.mark.parametrize("name", ["PYTHONHOME", "PYTHONPLATLIBDIR"])
def test_the_library_of_another_python_is_left_out(tmp_path: Path, name: str) -> None:
    done = launch({name: str(tmp_path)}, "--help")
    assert done.returncode == 0, done.stderr
    assert f"{name}={tmp_path}" in done.stderr
    assert f"unset {name}" in done.stderr


def test_compiled_sources_are_kept_where_the_environment_forbids_it(tmp_path: Path) -> None:
    forbidden = {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONPYCACHEPREFIX": str(tmp_path)}
    done = launch(forbidden, "--help")
    assert done.returncode == 0, done.stderr
    assert any(file.match("ssp_core/cycles.*.pyc") for file in tmp_path.rglob("*.pyc"))
    assert " PYTHONDONTWRITEBYTECODE\n" in launch(forbidden, "env").stdout


def test_a_middleware_that_is_not_there_is_left_out() -> None:
    done = launch({"RMW_IMPLEMENTATION": "rmw_of_nobody"}, "--help")
    assert done.returncode == 0, done.stderr
    assert "RMW_IMPLEMENTATION=rmw_of_nobody" in done.stderr
    assert "rmw_fastrtps_cpp" in done.stderr


def test_a_live_run_with_a_middleware_that_is_not_there_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "run"
    live = ("run", "cut_in", "--site", "north_track", "--mode", "live", "--out", str(out))
    done = launch({"RMW_IMPLEMENTATION": "rmw_of_nobody"}, *live)
    assert done.returncode == 1, done.stderr
    (error,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    for words in ("RMW_IMPLEMENTATION", "rmw_of_nobody", "export RMW_IMPLEMENTATION=rmw_fastrtps"):
        assert words in error
    assert "session" not in error


def test_entries_of_the_caller_are_found_behind_the_packages(tmp_path: Path) -> None:
    if not list(Path(sys.prefix).glob("lib/python3.*/site-packages/ssp_sources.pth")):
        pytest.skip("not the environment of ./ssp")
    (tmp_path / "numpy").mkdir()
    (tmp_path / "numpy" / "__init__.py").write_text("raise RuntimeError('of another workspace')")
    (tmp_path / "mine.py").write_text("")
    code = "import mine, numpy, sys; print(sys.path[-1])"
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**env, "SSP_PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.stdout.strip() == str(tmp_path), done.stderr


def find_python(folder: Path, programs: dict[str, str], **variables: str) -> tuple[int, str, str]:
    """Runs find_python where only these programs are found, each a script; as an ordinary user.

    The paths outside PATH that it tries are led into the folder.
    """
    for name in TOOLS:
        real = next(p for p in (Path("/usr/bin"), Path("/bin")) if (p / name).exists()) / name
        (folder / name).symlink_to(real)
    for name, script in programs.items():
        (folder / name).write_text(f"#!/bin/bash\n{script}\n")
        (folder / name).chmod(0o755)
    text = PYTHON_SH.read_text().replace("{/usr,/usr/local}", "{/nowhere,/nowhere/local}")
    text = text.replace("$EUID -eq 0", "$EUID -eq 4242").replace("/etc/os-release", "/nowhere/os")
    assert "/usr/bin/python$offered" in text
    copy = folder / "python.sh"
    copy.write_text(text)
    done = subprocess.run(
        [folder / "bash", "-c", "set -euo pipefail; source ./python.sh; find_python"],
        cwd=folder,
        env={"PATH": str(folder), **variables},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout.strip(), done.stderr


def candidate(*versions: str) -> str:
    cases = "".join(f'[[ "$2" == python{v} ]] && echo "  Candidate: {v}.1-1"\n' for v in versions)
    return f"{cases}exit 0"


OLD = '[[ "$1" == --version ]] && echo "Python 3.9.2" && exit 0; exit 1'
NO_SUDO = {"sudo": "exit 1"}


def test_the_newest_of_the_wheels_is_taken_under_any_name(tmp_path: Path) -> None:
    status, found, _ = find_python(tmp_path, {"python3.14": "echo /opt/python3.14"})
    assert (status, found) == (0, "/opt/python3.14")


def test_a_named_interpreter_that_will_not_do_is_not_passed_over(tmp_path: Path) -> None:
    good = {"python3.12": "echo /usr/bin/python3.12", "old": OLD}
    status, found, said = find_python(tmp_path, good, SSP_PYTHON="old")
    assert (status, found) == (1, "")
    assert "SSP_PYTHON=old" in said
    assert "Python 3.9.2" in said


def test_the_advice_of_apt_is_what_it_offers(tmp_path: Path) -> None:
    apt = {"apt-get": "exit 0", "apt-cache": candidate("3", "3.13"), "python3": OLD, **NO_SUDO}
    _, found, said = find_python(tmp_path, apt)
    assert found == ""
    assert "sudo apt-get install -y python3.13 python3.13-venv python3.13-dev" in said


def test_empty_lists_are_asked_for_first_and_other_words_follow(tmp_path: Path) -> None:
    empty = {"apt-get": "exit 0", "apt-cache": "exit 0", **NO_SUDO}
    _, _, said = find_python(tmp_path, empty)
    assert "sudo apt-get update" in said
    assert "install" not in said


@pytest.mark.parametrize(
    ("programs", "command"),
    [
        (
            {"dnf": 'case "$*" in *python3.11*) echo python3.11-0:3.11.9;; esac', **NO_SUDO},
            "sudo dnf install -y python3.11 python3.11-devel",
        ),
        (
            {"zypper": '[[ "$*" == *python313 ]]', **NO_SUDO},
            "sudo zypper install -y python313 python313-devel",
        ),
        ({"apt-get": "exit 0", "apt-cache": candidate("3"), **NO_SUDO}, "uv python install 3.13"),
        ({}, "uv python install 3.13"),
    ],
)
def test_other_systems_get_their_own_advice(
    tmp_path: Path, programs: dict[str, str], command: str
) -> None:
    status, found, said = find_python(tmp_path, {"python3": OLD, **programs})
    assert (status, found) == (1, "")
    assert command in said
    assert "Python 3.9.2" in said


@pytest.mark.parametrize(
    ("programs", "command"),
    [
        (
            {"apt-get": "exit 0", "apt-cache": candidate("3", "3.13")},
            "su -c 'apt-get install -y python3.13 python3.13-venv python3.13-dev'",
        ),
        ({"apt-get": "exit 0", "apt-cache": "exit 0"}, "su -c 'apt-get update'"),
        (
            {"dnf": 'case "$*" in *python3.11*) echo python3.11-0:3.11.9;; esac'},
            "su -c 'dnf install -y python3.11 python3.11-devel'",
        ),
    ],
)
def test_without_sudo_the_advice_names_what_there_is(
    tmp_path: Path, programs: dict[str, str], command: str
) -> None:
    _, _, said = find_python(tmp_path, programs)
    assert command in said
    assert "sudo" not in said


@pytest.mark.parametrize(
    ("programs", "lines"),
    [
        ({"curl": ""}, ["curl -LsSf https"]),
        ({"wget": ""}, ["wget -qO- https"]),
        (
            {"apt-get": "exit 0", "apt-cache": candidate("3")},
            ["su -c 'apt-get install -y curl ca-certificates'", "curl -LsSf https"],
        ),
        ({}, ["# first install curl", "curl -LsSf https"]),
    ],
)
def test_uv_is_fetched_by_what_this_machine_has(
    tmp_path: Path, programs: dict[str, str], lines: list[str]
) -> None:
    _, _, said = find_python(tmp_path, programs)
    advice = said.partition("without root:\n")[2].splitlines()
    for line, begins in zip(advice, lines, strict=False):
        assert line.strip().startswith(begins), said
    assert "uv python install" in advice[len(lines)]


def test_an_installation_that_fails_is_said_with_its_command(tmp_path: Path) -> None:
    programs = {
        "sudo": 'shift; [[ "$1" == true ]] && exit 0; exec "$@"',
        "apt-get": '[[ "$1" == update ]] && exit 1; echo "E: no space left" >&2; exit 100',
        "apt-cache": candidate("3", "3.13"),
    }
    status, found, said = find_python(tmp_path, programs)
    assert (status, found) == (1, "")
    assert "apt-get update failed" in said
    assert "E: no space left" in said
    command = "apt-get install -y --no-install-recommends python3.13 python3.13-venv python3.13-dev"
    words = "the installation failed. What this says must be mended, then ./ssp again:"
    assert f"{words}\n  sudo {command}\n" in said
    assert "packages have none" not in said


def test_with_sudo_that_asks_nothing_it_is_installed(tmp_path: Path) -> None:
    programs = {
        "sudo": 'shift; [[ "$1" == true ]] && exit 0; exec "$@"',
        "apt-get": f'echo "$*" >>{tmp_path}/asked',
        "apt-cache": candidate("3", "3.13"),
    }
    _, _, said = find_python(tmp_path, programs)
    asked = (tmp_path / "asked").read_text().splitlines()
    assert asked[0] == "update"
    assert asked[1].startswith("install -y")
    assert asked[1].endswith("python3.13 python3.13-venv python3.13-dev")
    assert "installing python3.13" in said
