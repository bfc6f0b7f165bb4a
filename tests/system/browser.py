"""A real browser without a window, driven by its DevTools protocol over a WebSocket.

Only what tests of pages need: it goes to an address, evaluates, clicks, presses keys, makes
screenshots, and remembers what the page wrote to the console and asked of the network.
"""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import Any, TypeVar

import aiohttp
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
START_S = 120.0
ANSWER_S = 120.0
T = TypeVar("T")


def find_browser() -> str:
    """Path of the browser; without one the test fails, because nothing else sees the page."""
    for name in NAMES:
        if (found := shutil.which(name)) is not None:
            return found
    pytest.fail("there is no browser to test the page with: apt-get install chromium")


class Browser:
    """One browser with one tab; leaving the block ends it.

    Args:
        size: of the window, px.
        dark: what the user prefers.
    """

    def __init__(self, size: tuple[int, int] = (1400, 900), *, dark: bool = True) -> None:
        self._size, self._dark = size, dark
        self.console: list[str] = []
        self.requests: list[str] = []
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._count = 0

    def __enter__(self) -> Browser:
        self._folder = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
        width, height = self._size
        self._process = subprocess.Popen(
            [
                find_browser(),
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-quic",
                "--disable-dev-shm-usage",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--hide-scrollbars",
                "--remote-debugging-port=0",
                f"--user-data-dir={self._folder.name}",
                f"--window-size={width},{height}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._do(self._connect(self._port()))
        self.resize(*self._size)
        return self

    def __exit__(self, *_: object) -> None:
        self._do(self._session.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    # -- what a person does ----------------------------------------------------------------------

    def go(self, url: str) -> None:
        """Opens an address and waits until the page is there."""
        self.ask("Page.navigate", url="about:blank")
        self.wait("location.href === 'about:blank'")  # an answer comes before the page is gone
        self.ask("Page.navigate", url=url)
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def resize(self, width: int, height: int, *, touch: bool = False) -> None:
        """Another window, or a phone's."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=touch,
        )
        self.ask("Emulation.setTouchEmulationEnabled", enabled=touch)

    def prefer(self, scheme: str) -> None:
        """``dark`` or ``light``."""
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.ask("Emulation.setEmulatedMedia", features=[feature])

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression in the page."""
        result = self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in result:
            raise AssertionError(f"{expression}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def wait(self, expression: str, timeout_s: float = ANSWER_S) -> Any:
        """Waits until an expression is true, and gives its value; in vain, the test fails."""
        deadline = time.monotonic() + timeout_s
        while not (value := self.evaluate(expression)):
            if time.monotonic() > deadline:
                pytest.fail(
                    f"waited {timeout_s:g} s in vain for {expression}; the page shows:\n"
                    f"{self.evaluate('document.body.innerText')[:3000]}\n{self.console}"
                )
            time.sleep(0.05)
        return value

    def text(self, selector: str) -> str:
        """Return the text of an element, empty where it is hidden."""
        return str(self.evaluate(f"document.querySelector({selector!r}).innerText"))

    def click(self, selector: str) -> None:
        """Presses the left button in the middle of an element, and lets go."""
        self.evaluate(f"document.querySelector({selector!r}).scrollIntoView({{block: 'nearest'}})")
        x, y = self._middle(selector)
        for kind in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def tap(self, selector: str) -> None:
        """Tap as a finger does."""
        x, y = self._middle(selector)
        self.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        self.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def press(self, key: str, code: str, number: int, text: str = "") -> None:
        """Presses a key and lets go."""
        about = {"key": key, "code": code, "windowsVirtualKeyCode": number}
        self.ask("Input.dispatchKeyEvent", type="keyDown", text=text, **about)
        self.ask("Input.dispatchKeyEvent", type="keyUp", **about)

    def space(self) -> None:
        self.press(" ", "Space", 32, " ")

    def screenshot(self, path: Path) -> None:
        """Save the visible page as PNG."""
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"]))

    # -- protocol --------------------------------------------------------------------------------

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the protocol, with its answer."""
        return self._do(self._ask(method, parameters))

    def _do(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(START_S)

    def _middle(self, selector: str) -> tuple[float, float]:
        box = self.evaluate(
            f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect();"
            " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        return box[0], box[1]

    def _port(self) -> int:
        file = Path(self._folder.name) / "DevToolsActivePort"
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                pytest.fail(f"the browser ended at once, with status {self._process.returncode}")
            if file.is_file() and "\n" in (text := file.read_text()):
                return int(text.splitlines()[0])
            time.sleep(0.05)
        pytest.fail(f"the browser did not start within {START_S:g} s")

    async def _connect(self, port: int) -> None:
        self._session = aiohttp.ClientSession()
        async with self._session.get(f"http://127.0.0.1:{port}/json/list") as response:
            tabs = json.loads(await response.text())
        (address,) = [tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page"][:1]
        self._socket = await self._session.ws_connect(address, max_msg_size=64 << 20)
        self._listening = asyncio.ensure_future(self._listen())
        for domain in ("Page", "Runtime", "Log", "Network"):
            await self._ask(f"{domain}.enable", {})
        scheme = "dark" if self._dark else "light"
        feature = {"name": "prefers-color-scheme", "value": scheme}
        await self._ask("Emulation.setEmulatedMedia", {"features": [feature]})

    async def _ask(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self._count += 1
        answer = self._waiting[self._count] = self._loop.create_future()
        await self._socket.send_json({"id": self._count, "method": method, "params": parameters})
        said: dict[str, Any] = await asyncio.wait_for(answer, ANSWER_S)
        if "error" in said:
            raise AssertionError(f"{method}: {said['error']}")
        return dict(said["result"])

    async def _listen(self) -> None:
        async for message in self._socket:
            said = json.loads(message.data)
            if "id" in said:
                waiting = self._waiting.pop(said["id"], None)
                if waiting is not None and not waiting.done():
                    waiting.set_result(said)
            else:
                self._hear(said["method"], said["params"])

    def _hear(self, method: str, said: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled":
            words = [str(a.get("value", a.get("description"))) for a in said["args"]]
            self.console.append(f"{said['type']}: {' '.join(words)}")
        elif method == "Runtime.exceptionThrown":
            details = said["exceptionDetails"]
            text = details.get("exception", {}).get("description", details["text"])
            self.console.append(f"exception: {text}")
        elif method == "Log.entryAdded":
            entry = said["entry"]
            self.console.append(f"{entry['level']}: {entry['text']} {entry.get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(said["url"])
