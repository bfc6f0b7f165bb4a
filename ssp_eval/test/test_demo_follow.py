"""Steps side by side: one waits for what it needs, one session at a time, all end in order."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import PeerError
from ssp_eval import demo
from ssp_eval.demo import Progress, follow
from ssp_eval.demo_plan import AT_ONCE, Step
from tests.support.processes.waiting import DEADLINE_S, until


class Script(Step):
    """A step that runs a piece of Python."""

    @property
    def modules(self) -> tuple[str, ...]:
        return ("ssp_piece",)


def script(name: str, code: str, *needs: str, session: bool = False) -> Script:
    return Script(name, f"do {name}", (code,), needs, session)


def timed(path: Path, name: str, meets: str = "") -> str:
    """Code that notes when it begins and ends; with one that it meets, it ends after that began."""
    return (
        "import time, pathlib\n"
        f"notes, name, meets = pathlib.Path({str(path)!r}), {name!r}, {meets!r}\n"
        "begin = time.monotonic()\n"
        "(notes / f'{name}.begun').touch()\n"
        "while meets and not (notes / f'{meets}.begun').exists(): time.sleep(0.01)\n"
        "(notes / f'{name}.span').write_text(f'{begin} {time.monotonic()}')"
    )


def spans(path: Path) -> dict[str, tuple[float, float]]:
    found = {}
    for file in path.glob("*.span"):
        begin, end = map(float, file.read_text().split())
        found[file.stem] = (begin, end)
    return found


@pytest.fixture
def logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    piece = "import sys\n\ndef main():\n    exec(sys.argv[1], {'__name__': 'piece'})\n"
    (tmp_path / "ssp_piece.py").write_text(piece)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    path = tmp_path / "logs"
    path.mkdir()
    return path


def nothing(*_: Any) -> None:
    pass


def test_steps_wait_for_what_they_need_and_share_the_host(tmp_path: Path, logs: Path) -> None:
    notes = tmp_path / "notes"
    notes.mkdir()
    plan = [("a", ""), ("s1", ""), ("s2", ""), ("b", "a"), ("c", "s1"), ("d", "b c s2")]
    meets = {"a": "s1", "s1": "a"}
    steps = [
        script(name, timed(notes, name, meets.get(name, "")), *needs.split(), session="s" in name)
        for name, needs in plan
    ]
    started: list[tuple[str, int]] = []
    ended: list[str] = []
    follow(steps, logs, lambda s, n: started.append((s.name, n)), lambda s: ended.append(s.name))
    found = spans(notes)
    assert set(found) == set(ended) == {name for name, _ in plan}
    assert [number for _, number in started] == [1, 2, 3, 4, 5, 6]
    for name, needs in plan:
        assert all(found[other][1] <= found[name][0] for other in needs.split())
    assert found["s1"][1] <= found["s2"][0] or found["s2"][1] <= found["s1"][0]
    moments = [begin for begin, _ in found.values()]
    at_once = [sum(b <= m < e for b, e in found.values()) for m in moments]
    assert max(at_once) == AT_ONCE
    assert {p.name for p in logs.iterdir()} == {f"{name}.log" for name, _ in plan}


def test_a_step_that_fails_costs_what_needs_it_and_shows_its_last_lines(logs: Path) -> None:
    """It cost report, package and all that had been done."""
    report = Step("report", "do report", ("pass",), after=("never", "other"))
    steps = [
        script("bad", "print('the reason'); raise SystemExit(3)"),
        script("other", "pass"),
        script("never", "raise SystemExit('ran')", "bad"),
        Script(report.name, report.title, report.arguments, after=report.after),
    ]
    ended: list[str] = []
    gaps = follow(steps, logs, nothing, lambda step: ended.append(step.name))
    assert ended == ["other", "report"]
    bad, never = gaps
    assert (bad.step.name, never.step.name) == ("bad", "never")
    assert bad.why.startswith("failed with status 3\n")
    assert bad.why.endswith("the reason")
    assert never.why == "needs bad"
    assert not (logs / "never.log").exists()


def test_finished_steps_are_taken_up_and_the_rest_is_made_anew(tmp_path: Path, logs: Path) -> None:
    made = tmp_path / "made"
    good = tmp_path / "good"
    count = tmp_path / "count"
    code = f"import pathlib; p = pathlib.Path({str(count)!r}); p.write_text(p.read_text() + 'x')"
    count.write_text("")

    def steps() -> list[Step]:
        late = f"import pathlib, sys; sys.exit(0 if pathlib.Path({str(good)!r}).exists() else 1)"
        return [
            script("a", code),
            Script("b", "do b", (late,), ("a",), makes=(made,)),
            script("c", code, "b"),
        ]

    def once() -> list[str]:
        progress = Progress.of(tmp_path, "plan")
        gaps = follow(steps(), logs, nothing, progress.finish, progress.finished_steps(steps()))
        return [gap.step.name for gap in gaps]

    assert once() == ["b", "c"]
    made.mkdir()
    (made / "half").write_text("of the step that failed")
    good.write_text("")
    assert once() == []
    assert not made.exists()
    assert count.read_text() == "xx"  # a once, c once
    changed = [script("a", code + " "), *steps()[1:]]
    assert Progress.of(tmp_path, "plan").finished_steps(steps()) == {"a", "b", "c"}
    assert Progress.of(tmp_path, "plan").finished_steps(changed) == set()
    assert Progress.of(tmp_path, "another plan").finished_steps(steps()) == set()


GRACEFUL = """
import signal, sys, time, pathlib
def end(*_):
    time.sleep(0.2)
    pathlib.Path({path!r}).write_text('in order')
    sys.exit(0)
signal.signal(signal.SIGINT, end)
pathlib.Path({ready!r}).write_text('')
time.sleep(600)
"""


def test_an_interrupt_while_a_step_is_being_started_ends_that_step_too(
    tmp_path: Path, logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = {
        name: (str(tmp_path / name), str(tmp_path / f"{name}.ready")) for name in ("one", "two")
    }
    steps = [
        script(name, GRACEFUL.format(path=path, ready=ready))
        for name, (path, ready) in paths.items()
    ]
    started = demo._start

    def start(step: Step, logs: Path) -> Any:
        running = started(step, logs)
        until(Path(paths[step.name][1]).exists, step.name)
        if step.name == "two":
            os.kill(os.getpid(), signal.SIGINT)
        return running

    monkeypatch.setattr(demo, "_start", start)
    with pytest.raises(PeerError, match="do one, do two: interrupted"):
        follow(steps, logs, nothing, nothing)
    assert [Path(path).read_text() for path, _ in paths.values()] == ["in order"] * 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_lets_every_step_end_in_order(
    number: signal.Signals, tmp_path: Path, logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ssp_eval.demo.END_TIMEOUT_S", 300.0)
    paths = {n: (str(tmp_path / n), str(tmp_path / f"{n}.ready")) for n in ("one", "two")}
    steps = [
        script(name, GRACEFUL.format(path=path, ready=ready))
        for name, (path, ready) in paths.items()
    ]

    def interrupt() -> None:
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline and not all(Path(r).exists() for _, r in paths.values()):
            time.sleep(0.02)
        os.kill(os.getpid(), number)

    handlers: dict[int, Any] = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(PeerError, match="do one, do two: interrupted"):
        follow(steps, logs, nothing, nothing)
    thread.join()
    assert [Path(path).read_text() for path, _ in paths.values()] == ["in order"] * 2
    assert {n: signal.getsignal(n) for n in handlers} == handlers


def test_a_step_that_does_not_end_is_killed(
    logs: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("ssp_eval.demo.END_TIMEOUT_S", 0.5)
    ready = tmp_path / "ready"
    stubborn = (
        "import signal, time, pathlib\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        f"pathlib.Path({str(ready)!r}).write_text('')\ntime.sleep(600)"
    )

    def interrupt() -> None:
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline and not ready.exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(PeerError, match="do stubborn: interrupted"):
        follow([script("stubborn", stubborn)], logs, nothing, nothing)
    thread.join()
