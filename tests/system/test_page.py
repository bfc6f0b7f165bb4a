"""The operators' page in a real browser, beside a real manager and real sessions."""

from __future__ import annotations

import os
import queue
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.run_file.model import RunSpec
from tests.support.processes.patience import patient, start_manager
from tests.support.processes.waiting import DEADLINE_S, until
from tests.support.runs import small_run
from tests.system.browser import Browser

pytestmark = [pytest.mark.ros, pytest.mark.system]

TOKEN = "a-token-for-tests-of-the-page"
OBJECTS = 20
STATE = "document.getElementById('state').innerText"
ANSWERS = "document.getElementById('answers').innerText"
BANNER = "document.getElementById('banner')"
HINT = "getComputedStyle(document.getElementById('abort-hint'))"


def run_of_many() -> RunSpec:
    """Twenty objects beside a straight road, and a VUT on it."""
    start = {"x_m": 10.0, "y_m": 0.0, "yaw_rad": 0.0}
    classes = ("car", "truck", "cyclist", "pedestrian")
    targets = [
        {
            "id": f"ot{k + 1}",
            "object_class": classes[k % len(classes)],
            "start": {"x_m": 30.0 + 15.0 * (k % 10), "y_m": 12.0 + 14.0 * (k // 10), "yaw_rad": 0},
        }
        for k in range(OBJECTS)
    ]
    trigger = {
        "id": "gap",
        "condition": {"type": "time_to_arrival", "anchor": (100.0, 0.0), "below_s": 2.0},
        "object_id": "ot1",
        "manoeuvre": {
            "kind": "follow_path",
            "motion": {"path": [(30.0, 12.0), (100.0, 2.0), (101.0, -5.0)], "cruise_mps": 3.0},
        },
    }
    origin = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    lane = {"y_m": 0.0, "width_m": 3.5, "direction": "forward"}
    approach = {"path": [(10.0, 0.0), (220.0, 0.0)], "cruise_mps": 11.0}
    run = small_run(
        scenario="many",
        mode="realtime",
        road={"origin": origin, "length_m": 240.0, "lanes": [lane]},
        geofence=[(-10.0, -30.0), (240.0, -30.0), (240.0, 50.0), (-10.0, 50.0)],
        vut={"id": "vut", "object_class": "car", "start": start, "approach": approach},
        targets=targets,
        triggers=[trigger],
    )
    return RunSpec.model_validate(patient(run))


class Stage:
    """The processes of a test: manager, played objects, page."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        self.folder = folder
        self.env = {**session_environment(domain_id), "SSP_PAGE_TOKEN": TOKEN}
        self.run_file = folder / "run.yaml"
        self.run_file.write_text(run_of_many().model_dump_json(by_alias=True))
        self.started: list[subprocess.Popen[Any]] = []

    def start(self, name: str, *command: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("ab") as out:
            process = subprocess.Popen(
                [sys.executable, *command], env=self.env, stdout=out, stderr=subprocess.STDOUT
            )
        self.started.append(process)
        return process

    def said(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()

    def wait_for_line(self, name: str, pattern: str) -> re.Match[str]:
        deadline = time.monotonic() + DEADLINE_S
        while (found := re.search(pattern, self.said(name), re.MULTILINE)) is None:
            if time.monotonic() > deadline:
                pytest.fail(f"{name} never said {pattern}:\n{self.said(name)}")
            time.sleep(0.05)
        return found

    def manager(self) -> None:
        with (self.folder / "manager.log").open("ab") as out:
            self.started.append(start_manager(self.env, out))

    def objects(
        self, *, moving: bool = False, single: bool = False, rate_hz: float = 20.0
    ) -> subprocess.Popen[bytes]:
        script = Path(__file__).with_name("played_objects.py")
        process = self.start(
            "objects",
            str(script),
            str(self.run_file),
            str(rate_hz),
            "1" if moving else "0",
            "single" if single else "array",
        )
        self.wait_for_line("objects", r"^loaded: True")
        return process

    def page(self, port: int = 0, *, run: bool = True) -> tuple[subprocess.Popen[bytes], int]:
        """The page's process, and its port."""
        name = f"page{len(self.started)}"
        given = ["-p", f"port:={port}"]
        given += ["-p", f"run_file:={self.run_file}"] if run else []
        process = self.start(name, "-m", "ssp_monitor.ros.page_node", "--ros-args", *given)
        found = self.wait_for_line(name, r"^page: http://127\.0\.0\.1:(\d+)/$")
        assert TOKEN not in self.said(name)
        return process, int(found[1])

    def close(self) -> None:
        for process in self.started:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with free_domain() as domain_id:
        made = Stage(tmp_path, domain_id)
        yield made
        made.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as one:
        yield one


@pytest.fixture
def tab(browser: Browser) -> Iterator[Browser]:
    """The browser, with nothing of another test in it."""
    browser.resize(1400, 900)
    browser.console.clear()
    browser.requests.clear()
    yield browser
    browser.go("data:text/html,nothing")


def keep(tab: Browser, name: str) -> None:
    """Leaves a picture for people where SSP_SCREENSHOTS names a folder."""
    if folder := os.environ.get("SSP_SCREENSHOTS"):
        tab.screenshot(Path(folder) / f"{name}.png")


def cells_of(object_id: str) -> str:
    """Return the expression for the cells of an object's row after its name."""
    cells = f"[...document.querySelectorAll('#object-{object_id} td')].slice(1)"
    return f"{cells}.map((cell) => cell.innerText)"


def values_of(tab: Browser, object_id: str) -> list[str]:
    """The cells of an object's row after its name."""
    return list(tab.evaluate(cells_of(object_id)))


def press(tab: Browser, command: str) -> None:
    """Clicks a button until the page asks: what moves or is disabled meanwhile isn't hit."""
    asked = f"document.querySelectorAll('#answers [data-command={command}]').length > 0"
    deadline = time.monotonic() + DEADLINE_S
    while not tab.evaluate(asked):
        assert time.monotonic() < deadline, f"no click on {command} is heard"
        tab.wait(f"!document.getElementById('command-{command}').disabled || {asked}")
        tab.click(f"#command-{command}")


def turn_fold(tab: Browser, turned: str) -> None:
    """Clicks the fold of further reasons until it is as wanted: while it moves it isn't hit."""
    deadline = time.monotonic() + DEADLINE_S
    while not tab.evaluate(turned):
        assert time.monotonic() < deadline, f"no click on the fold is heard: {turned}"
        tab.click("#standing summary")
        time.sleep(0.2)


def every_reason_can_be_read(tab: Browser) -> None:
    """Seven reasons are shown, and those of the other objects stand in a fold."""
    fold = "document.querySelector('#standing details')"
    tab.wait(f"{fold}.querySelectorAll('li').length > {OBJECTS}")
    assert tab.evaluate("document.querySelectorAll('#standing > ul > li').length") == 7
    tab.resize(1280, 800)
    turn_fold(tab, f"{fold}.open")
    told = f"{fold}.querySelector('summary').innerText"
    items = f"{fold}.querySelectorAll('li').length"
    tab.wait(f"{fold}.open && {told} === `and ${{{items}}} more`")
    # It stays open while reasons change, and the last one can be scrolled to.
    tab.evaluate(f"{fold}.querySelector('li').dataset.seen = 'before'")
    tab.wait(f"{fold}.querySelector('li').dataset.seen !== 'before'")
    assert tab.evaluate(f"{fold}.open")
    seen = tab.evaluate(
        f"(() => {{ const last = [...{fold}.querySelectorAll('li')].at(-1);"
        " last.scrollIntoView({block: 'nearest'}); const box = last.getBoundingClientRect();"
        " const at = document.elementFromPoint(box.x + 5, box.y + box.height / 2);"
        " return last.contains(at) && box.bottom <= innerHeight; })()"
    )
    assert seen
    keep(tab, "every-reason")
    turn_fold(tab, f"!{fold}.open")


def test_twenty_objects_commands_and_silence(stage: Stage, tab: Browser) -> None:
    stage.manager()
    objects = stage.objects(rate_hz=100.0)
    _, port = stage.page()
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")

    tab.wait(f"document.querySelectorAll('#objects tr').length === {OBJECTS + 1}")
    tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
    assert tab.evaluate("location.href") == f"http://127.0.0.1:{port}/"  # no token left in it
    assert tab.evaluate("document.getElementById('map').dataset.objects") == str(OBJECTS + 1)
    assert "the recorder is silent" in tab.text("#standing")
    every_reason_can_be_read(tab)
    # In one look: a busy machine may make a value old between two.
    cells = cells_of("ot1")
    tab.wait(f"{cells}[0] === 'DISARMED' && {cells}[1] === '0.00' && Number({cells}[2]) > 5.0")
    keep(tab, "not-armed")

    # The manager's own answer, word for word.
    assert tab.evaluate("document.getElementById('command-arm').disabled")
    press(tab, "connect")
    tab.wait(f"{ANSWERS}.includes('accepted, session CONNECTED')")
    tab.wait(f"{STATE} === 'CONNECTED'")
    press(tab, "arm")
    tab.wait(f"{ANSWERS}.includes('REFUSED')")
    answers = tab.text("#answers")
    assert "the recorder is silent" in answers
    assert "clock offset and link delay of ot1 are not measured" in answers
    keep(tab, "refused")

    # A source that is cut off is told of loudly, and its numbers go.
    objects.send_signal(signal.SIGSTOP)
    tab.wait(f"!{BANNER}.hidden")
    tab.wait("document.body.classList.contains('blind')")
    assert "is silent for" in tab.text("#banner")
    assert tab.evaluate("document.title").startswith("NO DATA")
    assert values_of(tab, "ot1")[:7] == ["—"] * 7
    assert tab.evaluate("getComputedStyle(document.getElementById('map')).filter") != "none"
    keep(tab, "stale")
    objects.send_signal(signal.SIGCONT)
    tab.wait(f"{BANNER}.hidden")
    tab.wait(f"{cells_of('ot1')}[1] === '0.00'")

    # The space bar, wherever the focus is; the button under it isn't pressed.
    tab.evaluate("document.getElementById('command-reset').focus()")
    tab.space()
    tab.wait(f"{ANSWERS}.includes('accepted, session ABORT') && {STATE}.startsWith('ABORT')")
    assert "reset" not in tab.text("#answers").lower()
    keep(tab, "aborted")

    assert tab.console == []
    assert {url.split("/")[2] for url in tab.requests} == {f"127.0.0.1:{port}"}
    assert all(TOKEN not in url for url in tab.requests)


def test_server_comes_back_and_abort_is_tried_until_it_is_heard(stage: Stage, tab: Browser) -> None:
    stage.manager()
    stage.objects(moving=True)
    page, port = stage.page()
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
    tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
    page.kill()
    page.wait()
    tab.wait(f"!{BANNER}.hidden && {BANNER}.innerText.includes('NOT CONNECTED')")
    assert values_of(tab, "ot3") == ["—"] * 8
    assert tab.evaluate("document.title").startswith("NOT CONNECTED")
    # Nobody is there to hear it, and a second press waits for no first one.
    tab.space()
    tab.space()
    tab.wait(f"({ANSWERS}.match(/still trying/g) ?? []).length === 2")
    keep(tab, "not-connected")
    stage.page(port)
    tab.wait(f"{BANNER}.hidden && {STATE}.startsWith('ABORT')")
    tab.wait(f"({ANSWERS}.match(/accepted, session ABORT/g) ?? []).length === 2")


def test_without_the_token_people_watch_and_abort(stage: Stage, tab: Browser) -> None:
    stage.manager()
    stage.objects()
    _, port = stage.page()
    for fragment, why in (("", "no token"), ("#token=not-the-right-token", "wrong token")):
        tab.resize(1400, 900)
        tab.go(f"http://127.0.0.1:{port}/{fragment}")
        tab.wait(f"{BANNER}.hidden && ['LOADED', 'ABORTED'].includes({STATE})")
        assert "space bar" in tab.text("#abort-hint")
        assert tab.evaluate(f"{HINT}.display") != "none"
        assert f"View and ABORT only: {why}" in tab.text("#no-token")
        stale = "ONLY ABORT WORKS IN THIS TAB" in tab.text("#no-token")
        assert stale == (why == "wrong token")
        buttons = "[...document.querySelectorAll('#commands button')]"
        assert tab.evaluate(f"{buttons}.every(b => b.disabled)")
        # A narrow window and a tablet, which may each have no keyboard.
        for size, touch in (((700, 900), False), ((1400, 900), True)):
            tab.resize(*size, touch=touch)
            assert tab.evaluate(f"{HINT}.display") == "none"
        # On a phone, with a finger.
        tab.resize(400, 800, touch=True)
        box = "JSON.stringify(document.getElementById('abort').getBoundingClientRect())"
        assert '"width":38' in tab.evaluate(box)
        assert tab.evaluate(f"{HINT}.display") == "none"
        tab.tap("#abort")
        tab.wait(f"{ANSWERS}.includes('accepted')")
        keep(tab, f"phone-{why.replace(' ', '-')}")


def test_without_a_run_file_it_shows_what_it_hears(stage: Stage, tab: Browser) -> None:
    stage.manager()
    stage.objects(single=True)
    _, port = stage.page(run=False)
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
    tab.wait(f"document.querySelectorAll('#objects tr').length === {OBJECTS + 1}")
    tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
    assert "No run file" in tab.text("#map-note")
    assert tab.text("#scenario") == "many"  # the session says it
    assert float(values_of(tab, "ot20")[2]) > 5.0


def test_abort_is_in_sight_on_every_window(stage: Stage, tab: Browser) -> None:
    """Also before anything was heard, and wherever the page was scrolled to."""
    _, port = stage.page()
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
    tab.wait("document.getElementById('banner-text').innerText.includes('never heard')")
    for size in ((1400, 900), (1000, 700), (700, 400), (400, 800), (320, 480)):
        tab.resize(*size)
        for scrolled in ("0", "document.body.scrollHeight"):
            tab.evaluate(f"scrollTo(0, {scrolled})")
            seen = tab.evaluate(
                "(() => { const b = document.getElementById('abort').getBoundingClientRect();"
                " const at = document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2);"
                " return b.top >= 0 && b.left >= 0 && b.bottom <= innerHeight"
                " && b.right <= innerWidth && b.height >= 60"
                " && document.getElementById('abort').contains(at); })()"
            )
            assert seen, f"at {size}, scrolled to {scrolled}"
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")


class SlowWay:
    """Passes everything on to a port, what comes back only later, as a long buffer would.

    Args:
        port: of the page.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self.delay_s = 0.0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                viewer, _ = self._listener.accept()
                page = socket.create_connection(("127.0.0.1", self._port))
                for work, *ends in ((self._there, viewer, page), (self._back, page, viewer)):
                    threading.Thread(target=work, args=ends, daemon=True).start()

    def _there(self, viewer: socket.socket, page: socket.socket) -> None:
        # The page knows its own port alone; as many digits, so that no length changes.
        own, known = f"127.0.0.1:{self.port}".encode(), f"127.0.0.1:{self._port}".encode()
        with suppress(OSError):
            while data := viewer.recv(65536):
                page.sendall(data.replace(own, known))
            page.shutdown(socket.SHUT_RDWR)

    def _back(self, page: socket.socket, viewer: socket.socket) -> None:
        kept: queue.Queue[tuple[float, bytes]] = queue.Queue()

        def deliver() -> None:
            with suppress(OSError):
                while (item := kept.get())[1]:
                    time.sleep(max(0.0, item[0] - time.monotonic()))
                    viewer.sendall(item[1])
                viewer.shutdown(socket.SHUT_RDWR)

        threading.Thread(target=deliver, daemon=True).start()
        with suppress(OSError):
            while data := page.recv(65536):
                kept.put((time.monotonic() + self.delay_s, data))
        kept.put((0.0, b""))


REPLAYING = """
import rclpy
rclpy.init()
rclpy.spin(rclpy.create_node("replay", namespace="/ssp"))
"""


def test_on_a_slow_way_nothing_passes_for_now_and_no_replay_for_a_session(
    stage: Stage, tab: Browser
) -> None:
    stage.manager()
    stage.objects(moving=True)
    _, port = stage.page()
    way = SlowWay(port)
    try:
        tab.go(f"http://127.0.0.1:{way.port}/#token={TOKEN}")
        tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
        way.delay_s = 1.3
        tab.wait(f"{BANNER}.innerText.includes('SLOW CONNECTION')")
        assert values_of(tab, "ot3")[:7] == ["—"] * 7
        assert tab.evaluate("document.getElementById('command-connect').disabled")
        keep(tab, "slow")
        way.delay_s = 0.0
        tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
        assert tab.evaluate("document.getElementById('replay').hidden")
        assert tab.evaluate("document.getElementById('not-started') === null")
        stage.start("replay", "-c", REPLAYING)
        shown = "!document.getElementById('replay').hidden"
        tab.wait(f"{shown} && document.title.startsWith('REPLAY')")
        tab.wait("[...document.querySelectorAll('#commands button')].every(b => b.disabled)")
        assert not tab.evaluate("document.getElementById('abort').disabled")
        keep(tab, "replay")
    finally:
        way.close()


TALKING = """
import rclpy
from ssp_core import names, ros
from ssp_msgs.msg import Heartbeat
rclpy.init()
node = rclpy.create_node("early_manager", namespace=names.NAMESPACE)
heartbeats = node.create_publisher(Heartbeat, names.HEARTBEAT, ros.STATE)
node.create_timer(0.05, lambda: heartbeats.publish(Heartbeat()))
rclpy.spin(node)
"""


def test_that_abort_would_not_be_heard_is_seen_before_it_is_pressed(
    stage: Stage, tab: Browser
) -> None:
    """The page hears a manager whose services aren't there."""
    stage.start("early", "-c", TALKING)
    _, port = stage.page(run=False)
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
    tab.wait(f"{BANNER}.innerText.includes('ABORT NOT HEARD')")
    assert tab.text("#abort-hint") == "not heard now"
    stage.manager()
    tab.wait(f"{BANNER}.hidden")
    assert tab.text("#abort-hint") == "space bar"


def test_blocked_storage_leaves_the_page_alive(stage: Stage, tab: Browser) -> None:
    stage.manager()
    stage.objects()
    _, port = stage.page()
    blocked = (
        "Object.defineProperty(window, 'sessionStorage', {get() { throw new Error('blocked'); }})"
    )
    made = tab.ask("Page.addScriptToEvaluateOnNewDocument", source=blocked)
    try:
        tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
        tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
        tab.press(" ", "", 32)  # a keyboard that gives no code
        tab.wait(f"{ANSWERS}.includes('accepted, session ABORT')")
    finally:
        tab.ask("Page.removeScriptToEvaluateOnNewDocument", identifier=made["identifier"])


def test_a_manager_that_hangs_is_named_and_few_requests_wait_for_it(
    stage: Stage, tab: Browser
) -> None:
    stage.manager()
    stage.objects()
    _, port = stage.page()
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
    tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
    manager = stage.started[0]
    manager.send_signal(signal.SIGSTOP)
    tab.space()
    tab.wait(f"{ANSWERS}.includes('the scenario manager gave no answer within 1 s')")
    for _ in range(6):
        tab.space()
    tab.wait(f"{ANSWERS}.includes('4 requests are still on their way')")
    manager.send_signal(signal.SIGCONT)
    tab.wait(f"(({ANSWERS}).match(/accepted, session ABORT/g) ?? []).length === 3")


def page_url(session: Any) -> str:
    session.wait_for("operator page: ")
    found = re.search(r"operator page: (\S+)", "".join(session.lines))
    assert found is not None
    return found[1]


ENDED = "document.getElementById('ended').innerText"


@pytest.mark.parametrize("abort", [False, True])
def test_an_orderly_end_is_heard_and_stays_on_the_page(
    start_session: Callable[..., Any], live_processes: Any, tab: Browser, abort: bool
) -> None:
    """It shouted NOT CONNECTED … Objects may be moving after every end, for ever."""
    session = start_session("cut_in", "--page", "0")  # its camera gives the page time to look
    tab.resize(1280, 800)
    tab.go(page_url(session))
    tab.wait(f"{STATE} === 'RUNNING'")
    # Recorder and losses, without scrolling.
    brief = "document.getElementById('recorder-brief')"
    tab.wait(f"{brief}.innerText.startsWith('recording · 0 lost · disk ')")
    assert tab.evaluate(f"{brief}.getBoundingClientRect().bottom < 150")
    if abort:
        tab.wait("Number(document.querySelector('#object-ot1 td:nth-child(3)').innerText) > 1")
        tab.wait("document.getElementById('camera-age').innerText.endsWith('ms old')")
        keep(tab, "running")
        tab.space()
        tab.wait(f"{STATE}.startsWith('ABORT') && {ANSWERS}.includes('accepted')")
        tab.wait("document.getElementById('events').innerText.includes('abort by operator page')")
        keep(tab, "aborting")
    head = "ended: aborted by the operator" if abort else "ended: valid"
    result = session.finish()  # waits for no viewer
    assert result["verdict"] == ("aborted" if abort else "valid")
    assert not abort or "operator page" in result["reasons"][0]
    assert "Traceback" not in (session.folder / "logs" / "monitor_page.log").read_text()
    tab.wait(f"{ENDED}.includes({head!r})")
    stood = re.search(r"everything stood at (\d+\.\d) s", tab.text("#ended"))
    assert stood is not None
    assert stood[1] == f"{result['session_s']:.1f}"
    assert tab.evaluate(f"{BANNER}.hidden")
    assert tab.evaluate("document.title") == f"{head} – SSP"
    assert tab.text("#abort-hint") == "the run has ended"
    assert tab.text("#next").startswith("Next: repeat" if abort else "Next: check")
    # It is served to who comes or reloads, until the terminal's word.
    tab.go(str(tab.evaluate("location.href")))
    tab.wait(f"{ENDED}.includes({head!r})")
    keep(tab, f"ended-{result['verdict']}")
    found = re.search(r"`kill (\d+)` ends it now", "".join(session.lines))
    assert found is not None
    os.kill(int(found[1]), signal.SIGTERM)
    until(lambda: not live_processes(session.folder), "end of the page on its signal")
    # Longer than the silence that is told of while a run goes on.
    tab.evaluate("new Promise((done) => setTimeout(done, 2500))")
    assert tab.evaluate(f"{BANNER}.hidden")
    assert tab.text("#ended").startswith(head)


def test_the_death_of_the_manager_goes_on_shouting(
    long_session: Callable[..., Any], tab: Browser
) -> None:
    """The run ends, but no participant has confirmed that everything stands."""
    session = long_session("--page", "0")
    tab.go(page_url(session))
    tab.wait(f"{STATE} === 'RUNNING'")
    session.kill("scenario_manager")
    tab.wait(f"!{BANNER}.hidden")
    assert session.finish()["verdict"] == "invalid_harness"
    tab.wait(f"{BANNER}.innerText.includes('NOT KNOWN TO STAND')")
    assert "Objects may be moving" in tab.text("#banner")
    assert tab.evaluate("document.getElementById('ended').hidden")
    assert "keep clear" in tab.text("#next")
    # However long the reasons are, with the last lines of its log, the map stays in sight.
    tab.wait("document.getElementById('state-why').innerText.includes('its last lines')")
    assert tab.evaluate("document.querySelector('main').getBoundingClientRect().top < 300")
    assert tab.text("#abort-hint") == "not heard now"
    found = re.search(r"`kill (\d+)` ends it now", "".join(session.lines))
    assert found is not None
    os.kill(int(found[1]), signal.SIGTERM)
    tab.wait(f"{BANNER}.innerText.includes('NOT CONNECTED')")
    assert "Objects may be moving" in tab.text("#banner")


def test_a_manager_that_falls_silent_without_an_end_is_shouted(stage: Stage, tab: Browser) -> None:
    stage.manager()
    stage.objects()
    _, port = stage.page()
    tab.go(f"http://127.0.0.1:{port}/#token={TOKEN}")
    tab.wait(f"{BANNER}.hidden && {STATE} === 'LOADED'")
    for number in (signal.SIGSTOP, signal.SIGKILL):
        stage.started[0].send_signal(number)
        tab.wait(f"{BANNER}.innerText.includes('the scenario manager is silent for')")
        assert tab.evaluate("document.getElementById('ended').hidden")
