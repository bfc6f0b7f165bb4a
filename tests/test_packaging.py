"""The files that build and install the project agree: packages, locks, image, licence."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(p.parent.name for p in ROOT.glob("ssp_*/package.xml"))
PYTHON_PACKAGES = [name for name in PACKAGES if name != "ssp_msgs"]
# Import names of requirements that are called otherwise.
REQUIRED_AS = {
    "carla_driver_interface": "carla-driver-interface",
    "cv2": "opencv-python-headless",
    "grpc": "grpcio",
    "yaml": "pyyaml",
}
# What a requirement brings along as a part of its own interface.
BROUGHT_BY = {
    "lz4": "mcap",
    "markupsafe": "jinja2",
    "pydantic_core": "pydantic",
    "typing_extensions": "pydantic",
    "zstandard": "mcap",
}
# Extras of the project, imported only where they are installed.
EXTRA = {"carla", "ray"}
OURS = {*PACKAGES, "ssp_core"}
# A file is a topic.
MOST_LINES = 650
# A name may be ``told``: a parameter stands before a colon.
NO_SUBJECT = re.compile(r"\b(nobody|whoever|told(?!:))\b", re.IGNORECASE)
# A function's docstring begins with a verb, those of classes and modules with a noun.
NEVER_FIRST = re.compile(
    r"\W*(who|whose|whom|what|which|when|where|why|how|whether|whatever|whoever|wherever|nobody|"
    r"none|of|for|with|without|in|inside|by|from|at|on|to|up to|into|over|under|above|below|across|"
    r"through|per|along|between|among|before|after|behind|beside|beyond|against|within|until|since|"
    r"during|while|as|if|once|than|like|unlike|because|despite)\b",
    re.IGNORECASE,
)
# A variable is named by what it holds, not by what was done to it.
NO_NAMES = re.compile(
    r"asked|came|chosen|drawn|found|given|heard|judged|kept|known|made|meant|met|said|seen|shown|"
    r"stood|taken|told|wanted|went"
)
# Of ROS, beside everything that ends in _msgs.
ROS_PACKAGES = {"builtin_interfaces", "rcl_interfaces", "rclpy", "std_srvs"}


def manifest(package: str) -> ElementTree.Element:
    return ElementTree.parse(ROOT / package / "package.xml").getroot()


def sources(package: str) -> list[Path]:
    folder = "ssp_core" if package == "ssp_msgs" else package
    return sorted((ROOT / package / folder).rglob("*.py"))


def all_of(folder: str) -> list[Path]:
    """The sources of a folder with its tests."""
    return sorted((ROOT / folder).rglob("*.py"))


@cache
def nodes(file: Path) -> list[ast.AST]:
    """All nodes of a source file, which several tests look through."""
    return list(ast.walk(ast.parse(file.read_text())))


def imported(files: list[Path]) -> set[str]:
    """Top-level names that the files import."""
    found: set[str] = set()
    for file in files:
        for node in nodes(file):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                found.add(node.module.split(".")[0])
    return found


def requirement_names(text: str) -> set[str]:
    names = set()
    for line in text.splitlines():
        match = re.match(r"[A-Za-z0-9][A-Za-z0-9._-]*", line)
        if match:
            names.add(re.sub(r"[-_.]+", "-", match.group()).lower())
    return names


def test_all_packages_are_there() -> None:
    assert PACKAGES == [
        "ssp_eval",
        "ssp_monitor",
        "ssp_msgs",
        "ssp_ot_controller",
        "ssp_scenario_manager",
        "ssp_vla_bridge",
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_licence_version_and_itself(package: str) -> None:
    root = manifest(package)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert root.get("format") == "3"
    assert root.findtext("name") == package
    assert root.findtext("license") == "Apache-2.0"
    assert root.findtext("version") == project["version"]


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_everything_that_is_imported(package: str) -> None:
    declared = {
        e.text for e in manifest(package) if e.tag in ("depend", "exec_depend", "build_depend")
    }
    if package != "ssp_msgs":
        # Comes with ssp_msgs, on which every package depends.
        assert "ssp_msgs" in declared
        declared |= {e.text for e in manifest("ssp_msgs") if e.tag.endswith("depend")}
    names = {BROUGHT_BY.get(name, name) for name in imported(sources(package))}
    ros = {n for n in names if n.endswith("_msgs") or n in ROS_PACKAGES}
    assert ros - OURS <= declared
    others = {n for n in names if n not in sys.stdlib_module_names} - ros - OURS - EXTRA
    wanted = requirement_names((ROOT / "bootstrap" / "runtime.in").read_text())
    assert {REQUIRED_AS.get(n, n) for n in others} <= wanted


# What apt has of ROS Jazzy on Ubuntu 24.04, beside everything that ends in _msgs.
OF_ROS = {
    "ament_cmake",
    "ament_cmake_python",
    "builtin_interfaces",
    "launch",
    "launch_ros",
    "rcl_interfaces",
    "rclpy",
    "rosidl_default_generators",
    "rosidl_default_runtime",
    "std_srvs",
}


@pytest.mark.parametrize("package", PACKAGES)
def test_rosdep_is_asked_for_packages_of_ros_alone(package: str) -> None:
    """Its Python keys end in Ubuntu's pydantic 1, in no numba at all, and in pip outside a venv."""
    keys = {e.text or "" for e in manifest(package) if e.tag.endswith("depend")} - OURS
    assert {key for key in keys if not key.endswith("_msgs")} <= OF_ROS


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_entry_points_exist(package: str) -> None:
    text = (ROOT / package / "setup.py").read_text()
    entries = re.findall(r'"(\w+) = ([\w.]+):(\w+)"', text)
    assert entries
    for _, module, function in entries:
        file = ROOT / package / Path(*module.split(".")).with_suffix(".py")
        assert f"def {function}(" in file.read_text()


ALLOWED = {
    "ssp_msgs": set(),
    "ssp_scenario_manager": set(),
    "ssp_ot_controller": set(),
    "ssp_monitor": set(),
    "ssp_vla_bridge": set(),
    "ssp_eval": {"ssp_vla_bridge", "ssp_scenario_manager", "ssp_ot_controller"},
}


# Tables of commands, nodes, backends and providers: modules that are loaded or started by name.
TABLES_OF_NAMES = [
    "ssp_eval/ssp_eval/audit/cli.py",
    "ssp_msgs/ssp_core/cli.py",
    "ssp_msgs/ssp_core/world/providers.py",
    "ssp_ot_controller/ssp_ot_controller/rehearsal/__main__.py",
    "ssp_scenario_manager/ssp_scenario_manager/cli/spec.py",
    "ssp_scenario_manager/ssp_scenario_manager/cli/spec_extract.py",
    "ssp_scenario_manager/ssp_scenario_manager/closed_loop/campaigns/seal.py",
    "ssp_scenario_manager/ssp_scenario_manager/run/over_dds/companions.py",
    "ssp_scenario_manager/ssp_scenario_manager/run/over_dds/session.py",
    "ssp_vla_bridge/ssp_vla_bridge/backend.py",
]
MODULE_NAME = re.compile(rf"({'|'.join(sorted(OURS))})(\.\w+)+\.?(:\w*)?")


def named(file: Path) -> set[str]:
    """Modules of ours that a file names in strings, by which it could load them past the layers."""
    texts = (str(node.value) for node in nodes(file) if isinstance(node, ast.Constant))
    return {text.partition(":")[0].rstrip(".") for text in texts if MODULE_NAME.fullmatch(text)}


def named_as_imports(file: Path) -> set[str]:
    """Modules that a file names outside a table; an ``__init__`` is the table of a public API."""
    is_table = file.name == "__init__.py" or file in [ROOT / place for place in TABLES_OF_NAMES]
    return set() if is_table else named(file)


@pytest.mark.parametrize(
    "source",
    [
        'importlib.import_module("ssp_eval.evaluate.driving")',
        'MODULE = "ssp_eval.evaluate.driving"',
        'place = f"ssp_eval.evaluate.driving:{function}"',
        'PLACE = "ssp_eval.evaluate.driving:make_driver"',
    ],
)
def test_a_module_that_is_named_in_a_string_counts_as_imported(tmp_path: Path, source: str) -> None:
    (tmp_path / "door.py").write_text(source)
    assert named_as_imports(tmp_path / "door.py") == {"ssp_eval.evaluate.driving"}


def test_each_table_of_names_is_there_and_names_modules() -> None:
    assert [place for place in TABLES_OF_NAMES if not named(ROOT / place)] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_dependencies_point_one_way(package: str) -> None:
    files = sources(package)
    by_name = {module.split(".")[0] for file in files for module in named_as_imports(file)}
    others = (imported(files) | by_name) & OURS - {package, "ssp_core", "ssp_msgs"}
    assert others <= ALLOWED[package]


def folder_imports(package: str) -> dict[str, set[str]]:
    """The folders of a package, and which others of it each of them imports."""
    name = "ssp_core" if package == "ssp_msgs" else package
    root = ROOT / package
    modules = {
        ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): file
        for file in sources(package)
    }

    def folder_of(module: str) -> str:
        # A command stands above the folders that it calls, its own among them.
        is_own = modules[module].name in ("__init__.py", "cli.py")
        return module if is_own else module.rpartition(".")[0]

    found: dict[str, set[str]] = {}
    for module, file in modules.items():
        by_name = {folder_of(target) for target in named_as_imports(file) & modules.keys()}
        found.setdefault(folder_of(module), set()).update(by_name)
        for node in nodes(file):
            if not isinstance(node, ast.ImportFrom) or (node.module or "").split(".")[0] != name:
                continue
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                target = inner if inner in modules else str(node.module)
                found[folder_of(module)].add(folder_of(target))
    return {folder: others - {folder} for folder, others in found.items()}


@pytest.mark.parametrize("package", PACKAGES)
def test_the_folders_of_a_package_import_one_way(package: str) -> None:
    TopologicalSorter(folder_imports(package)).prepare()  # raises for a circle, and names it


@pytest.mark.parametrize("package", PACKAGES)
def test_the_rooms_of_a_package_import_one_way(package: str) -> None:
    """Rooms are the folders directly in it, with all that lies in them and their commands."""
    rooms: dict[str, set[str]] = {}
    for folder, others in folder_imports(package).items():
        room, *used = (".".join(one.split(".")[:2]) for one in (folder, *others))
        rooms.setdefault(room, set()).update(used)
    # Files that lie in no room stand above them, or below.
    root = "ssp_core" if package == "ssp_msgs" else package
    TopologicalSorter(
        {room: used - {room, root} for room, used in rooms.items() if room != root}
    ).prepare()


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_are_named_for_what_they_hold_and_files_can_be_read_at_once(package: str) -> None:
    files = sources(package)
    folders = {part for file in files for part in file.relative_to(ROOT / package).parts[1:-1]}
    assert not folders & {"core", "common", "utils", "helpers", "misc", "spec", "target"}
    assert [file for file in files if len(file.read_text().splitlines()) > MOST_LINES] == []


# Records that mirror a file's form or a row of results, and have a field for each of its fields.
WIDE_RECORDS = {
    "Actor",
    "Card",
    "CellFacts",
    "ClipFacts",
    "ImportRecord",
    "Judgement",
    "Limits",
    "ModelEntry",
    "RecordingEntry",
    "RunSpec",
    "ScoreFile",
    "SiteBlock",
    "Task",
}
# Classes that may not have more attributes than they have.
STILL_WIDE = {"Binder": 20, "ClauseFacts": 33}
MOST_ATTRIBUTES = 15
MOST_PARTICIPLES = 18


def attributes(cls: ast.ClassDef) -> set[str]:
    """Names that a class declares, or that its methods assign to ``self``."""
    assigned = {
        node.attr
        for node in ast.walk(cls)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and isinstance(node.value, ast.Name)
        and node.value.id == "self"
    }
    declared = {
        node.target.id
        for node in cls.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    return assigned | declared


def is_frozen(cls: ast.ClassDef) -> bool:
    return any("frozen=True" in ast.unparse(decorator) for decorator in cls.decorator_list)


def test_a_class_owns_no_more_state_than_a_reader_can_hold() -> None:
    wide = []
    for package in PACKAGES:
        for file in sources(package):
            for node in nodes(file):
                if not isinstance(node, ast.ClassDef) or is_frozen(node):
                    continue
                count, most = len(attributes(node)), STILL_WIDE.get(node.name, MOST_ATTRIBUTES)
                if node.name not in WIDE_RECORDS and count > most:
                    wide.append(f"{file.relative_to(ROOT)}: {node.name} has {count}, most {most}")
    assert not wide, "\n".join(wide)


def participles(file: Path) -> Iterator[str]:
    """Variables and parameters of a file's functions that are named by participles."""
    for function in nodes(file):
        if not isinstance(function, (ast.FunctionDef, ast.Lambda)):
            continue
        for node in ast.walk(function):
            name = ""
            if isinstance(node, ast.arg):
                name = node.arg
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                name = node.id
            if NO_NAMES.fullmatch(name.strip("_")):
                yield f"{file.relative_to(ROOT)}: {name}"


def test_variables_are_nouns_and_no_participles() -> None:
    """Left are parameters that others give by keyword, such as the options of commands."""
    names = {name for one in PACKAGES for file in sources(one) for name in participles(file)}
    assert len(names) <= MOST_PARTICIPLES, "\n".join(sorted(names))


def test_the_formatter_is_rarely_switched_off() -> None:
    """Tables that are data stand aside of code instead."""
    files = [
        file for folder in (*PACKAGES, "bootstrap", "docs", "tests") for file in all_of(folder)
    ]
    off = re.compile(r"# fmt: (skip|off)")
    found = [len(off.findall(file.read_text())) for file in files if file != Path(__file__)]
    assert sum(found) < 40


@pytest.mark.parametrize("folder", [*PACKAGES, "bootstrap", "docs", "tests"])
def test_docstrings_open_with_verb_or_noun_and_have_a_subject(folder: str) -> None:
    """Docstrings don't open with a question word or a preposition, and their subject is a thing."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    found = []
    for file in all_of(folder):
        for node in ast.walk(ast.parse(file.read_text())):
            text = ast.get_docstring(node) if isinstance(node, documented) else None
            if NEVER_FIRST.match(text or "") or NO_SUBJECT.search(text or ""):
                found.append(f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}: {text}")
    assert not found, "\n".join(found)


def pins(lock: str) -> dict[str, str]:
    """The versions that a lock pins, by package; a version for each marker."""
    text = (ROOT / "bootstrap" / lock).read_text()
    entries = re.findall(r"^[a-zA-Z0-9].*?(?=^[a-zA-Z0-9]|\Z)", text, re.S | re.M)
    assert all("==" in e and "--hash=sha256:" in e for e in entries)
    found: dict[str, str] = {}
    for entry in entries:
        name, _, version = entry.split(" \\\n")[0].partition("==")
        found[name] = f"{found.get(name, '')} {version}".strip()
    return found


@pytest.mark.parametrize(
    ("lock", "inputs"),
    [
        ("requirements.lock", ("ros.in", "runtime.in")),
        ("test.lock", ("test.in",)),
        ("docs.lock", ("docs.in",)),
    ],
)
def test_the_lock_pins_every_requirement_with_hashes(lock: str, inputs: tuple[str, ...]) -> None:
    for name in inputs:
        wanted = requirement_names((ROOT / "bootstrap" / name).read_text())
        assert wanted <= set(pins(lock)), name


def test_tests_and_site_add_packages_and_change_none() -> None:
    of_all = pins("requirements.lock")
    known = dict(of_all)
    for lock in ("test.lock", "docs.lock"):
        of_lock = pins(lock)
        for name in of_lock.keys() & known.keys():
            assert of_lock[name].split(" ;")[0] == known[name].split(" ;")[0], name
        known |= of_lock
    assert not {"mypy", "ruff", "ray", "hypothesis"} & of_all.keys()


def test_the_tests_speak_to_carla_by_the_client_of_the_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (wanted,) = project["optional-dependencies"]["carla"]
    name, _, version = wanted.partition("==")
    assert pins("test.lock")[name].split(" ;")[0] == version


def test_every_place_names_the_same_versions_of_python() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    oldest, after = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", project["requires-python"]).groups()  # type: ignore[union-attr]
    minors = range(int(oldest), int(after))
    text = (ROOT / "bootstrap" / "python.sh").read_text()
    tried = re.search(r"ssp_versions=\((.+)\)", text)[1].split()  # type: ignore[index]
    assert sorted(tried) == [f"3.{minor}" for minor in minors]
    assert f"(3, {minors[0]}) <= sys.version_info[:2] <= (3, {minors[-1]})" in text
    bootstrap = (ROOT / "bootstrap" / "bootstrap.py").read_text()
    assert f"OLDEST, NEWEST = (3, {minors[0]}), (3, {minors[-1]})" in bootstrap
    assert f"Python 3.{minors[0]} to 3.{minors[-1]}" in (ROOT / "README.md").read_text()


def test_the_project_asks_for_nothing_that_is_not_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = requirement_names("\n".join(project["dependencies"]))
    wanted |= requirement_names("\n".join(project["optional-dependencies"]["sil"]))
    assert wanted == requirement_names((ROOT / "bootstrap" / "runtime.in").read_text())


def test_image_and_readme_set_a_ros_machine_up_by_the_same_lines() -> None:
    readme = (ROOT / "README.md").read_text().split("## On a ROS machine")[1]
    rosdep, once, every, launch = re.search(r"(    .+\n){4}", readme)[0].split("\n")[:4]  # type: ignore[index]
    image = (ROOT / "docker" / "Dockerfile").read_text()
    assert "FROM ros:jazzy" in image
    for line in (rosdep, once):
        assert line.split("#")[0].strip() in image
    entry = ROOT / "docker" / "entrypoint.sh"
    assert entry.stat().st_mode & 0o111
    assert "/docker/entrypoint.sh" in image
    assert every.split("#")[0].strip() in entry.read_text().replace("/ssp/", "")
    assert launch.split()[:2] == ["ros2", "launch"]
    for name in re.findall(r"bootstrap/[\w.]+", once):
        assert (ROOT / name).is_file()


def test_the_build_on_the_wheels_leaves_out_the_messages_of_cpp_alone() -> None:
    """No subscription works without introspection, but stale libraries may hide that."""
    text = (ROOT / "bootstrap" / "wheels.cmake").read_text()
    regex = re.search(r'EXCLUDE REGEX "(.+)"\)', text)[1]  # type: ignore[index]
    kept = (
        "generator_c",
        "generator_py",
        "typesupport_c",
        "typesupport_fastrtps_c",
        "typesupport_introspection_c",
    )
    assert not [name for name in kept if re.search(regex, f"rosidl_{name}:x.cmake")]
    assert re.search(regex, "rosidl_typesupport_introspection_cpp:x.cmake")


def test_everything_is_apache_licensed() -> None:
    assert "Apache License" in (ROOT / "LICENSE").read_text()
    for package in PYTHON_PACKAGES:
        assert 'license="Apache-2.0"' in (ROOT / package / "setup.py").read_text()


def test_each_error_of_input_names_a_remedy() -> None:
    """One that passes the whole message of another error on has it in there."""
    without = []
    for file in (file for package in PACKAGES for file in sources(package)):
        for node in nodes(file):
            if not isinstance(node, ast.Call) or ast.unparse(node.func) != "InputError":
                continue
            passes_on = not node.keywords and not isinstance(
                node.args[0], ast.Constant | ast.JoinedStr
            )
            if not passes_on and "remedy" not in [keyword.arg for keyword in node.keywords]:
                without.append(f"{file.relative_to(ROOT)}:{node.lineno}")
    assert not without, "\n".join(without)
