"""Any Python function as a model."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import make_backend, respond

MODEL = """
import numpy as np
from ssp_vla_bridge.messages import Answer

def text(request):
    return "I stop."

def drive(request):
    return "I keep my speed.", [(0.0, 0.0), (4.0, 0.0), (8.0, 0.0)]

def array(request):
    return "I turn.", np.array([[0.0, 0.0], [4.0, 0.5], [8.0, 1.0]], dtype=np.float32)

def whole(request):
    return Answer(f"id {request.request_id}", decoding={"seed": 1})

def chosen(request, options):
    return options["say"]

def anything(request, **more):
    return str(sorted(more))

class Model:
    def __init__(self):
        self.asked = 0
    def drive(self, request):
        self.asked += 1
        return f"asked {self.asked} times"

model = Model()
number = 5

def none(request):
    return None

def ragged(request):
    return "", [(0.0, 0.0), (1.0,)]

def words(request):
    return "", [("left", "right")]

def endless(request):
    while True:
        yield 0.0, 0.0

def many(request):
    return "", endless(request)

def fails(request):
    raise KeyError("weights")

def nan(request):
    return "", [(0.0, 0.0), (float("nan"), 0.0), (8.0, 0.0)]
"""


@pytest.fixture
def ask(tmp_path, make_request, monkeypatch):
    """The response of the function of that name in a module of its own."""
    name = f"my_model_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(MODEL)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def call(function, **options):
        given = {"function": f"{name}:{function}", "folder": str(tmp_path), **options}
        return respond(make_backend("python", given), "mine", make_request()).response

    yield call
    sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("function", "text", "ys"),
    [
        ("text", "I stop.", None),
        ("drive", "I keep my speed.", (0.0, 0.0, 0.0)),
        ("array", "I turn.", (0.0, 0.5, 1.0)),
        ("whole", "id r1", None),
        ("model.drive", "asked 1 times", None),
        ("anything", "['options']", None),
    ],
)
def test_what_a_function_gives_is_the_answer(ask, function, text, ys):
    response = ask(function)
    assert (response.error_code, response.text) == (0, text)
    trajectory = adapt("waypoints", response).trajectory
    assert ys == (None if trajectory is None else trajectory.y_m)


def test_points_have_the_tasks_step_unless_an_option_says_otherwise(ask):
    assert adapt("waypoints", ask("drive")).trajectory.t_s == (0.0, 0.5, 1.0)
    later = adapt("waypoints", ask("drive", step_s=1.0, first_time_s=1.0))
    assert later.trajectory.t_s == (0.0, 1.0, 2.0, 3.0)
    assert later.info.origin_added


def test_options_go_to_a_function_that_takes_them(ask):
    assert ask("chosen", options={"say": "hello"}).text == "hello"
    with pytest.raises(InputError, match="takes no keyword named options"):
        ask("drive", options={"say": "hello"})


def test_a_dotted_path_names_a_function_too(make_request):
    backend = make_backend("python", {"function": "textwrap.dedent"})
    with pytest.raises(TypeError):
        backend.answer(make_request())
    assert backend.model_id == "python(textwrap.dedent)"


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("none", "the function gave NoneType; it must give an Answer"),
        ("ragged", "point 1 has 1 numbers; a point is (x, y)"),
        ("words", "are no rows of two numbers"),
        ("many", "gives more than 131072 points"),
        ("fails", "KeyError: 'weights'"),
    ],
)
def test_what_no_answer_can_be_made_of_is_an_error(ask, function, words):
    response = ask(function)
    assert response.error_code == 2
    assert words in response.error_msg


def test_a_number_that_is_none_is_left_to_the_adapter(ask):
    adapted = adapt("waypoints", ask("nan"))
    assert (adapted.trajectory, adapted.invalid) == (None, ("non_finite",))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "backend_options.function: is missing"),
        ({"function": "drive"}, "names no function"),
        ({"function": "drive:"}, "names no function"),
        ({"function": "no_such_module:drive"}, "there is no module no_such_module"),
        ({"function": "no_such_module:drive"}, "PYTHONPATH"),
        ({"function": "json.no_such:drive"}, "there is no module json.no_such"),
        ({"function": "json:drive"}, "__init__.py has no drive"),
        ({"function": "json:__name__"}, "is a str, no function"),
        ({"function": "json:dumps", "folder": "/no/such"}, "folder: is no folder"),
        ({"function": "json:dumps", "step_s": 0}, "step_s: must lie in"),
        ({"function": "json:dumps", "interface": "x"}, "unknown interface"),
        ({"function": "json:dumps", "speed": 1}, "is no option of python"),
    ],
)
def test_wrong_options_are_named(options, words):
    with pytest.raises(InputError) as caught:
        make_backend("python", options)
    assert words in str(caught.value)


_HERE = """
import sys
from ssp_vla_bridge.backend import make_backend
name, options = "python", {"function": "my_own_model:drive"}
if sys.argv[1] == "factory":
    name, options = "my_own_model:make", {}
print(make_backend(name, options).model_id)
import yaml
"""


@pytest.mark.parametrize("kind", ["function", "factory"])
def test_a_model_of_the_working_folder_is_found_behind_all_packages(tmp_path, kind):
    (tmp_path / "my_own_model.py").write_text(
        "class Made:\n    model_id = 'made'\n\n\n"
        "def make(options):\n    return Made()\n\n\ndef drive(request):\n    return ''\n"
    )
    (tmp_path / "yaml.py").write_text("raise SystemExit('the folder comes first')\n")
    done = subprocess.run(
        [sys.executable, "-P", "-c", _HERE, kind],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() in ("python(my_own_model:drive)", "made")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import no_such_package\n", "raises ModuleNotFoundError: No module named"),
        ("1 / 0\n", "raises ZeroDivisionError: division by zero"),
        ("def broken(:\n", "raises SyntaxError"),
        ("raise SystemExit(3)\n", "raises SystemExit: 3"),
    ],
)
def test_a_module_that_cant_be_imported_is_named_with_its_file(
    tmp_path, monkeypatch, source, words
):
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "broken_model.py"
    path.write_text(source)
    with pytest.raises(InputError) as caught:
        make_backend("python", {"function": "broken_model:f", "folder": str(tmp_path)})
    assert f"can't be imported: {path} {words}" in str(caught.value)


def test_points_of_any_kind_are_taken_as_they_are(make_request):
    from ssp_vla_bridge.backends.python import PythonFunction

    for points in ([[1, 2]], ((1.0, 2.0),), np.array([[1, 2]]), iter([(1, 2)])):
        answer = PythonFunction(lambda _, p=points: ("", p), "m").answer(make_request())
        assert answer.arrays[0].data == (1.0, 2.0)
    with pytest.raises(PeerError):
        PythonFunction(lambda _: ("", 5), "m").answer(make_request())
