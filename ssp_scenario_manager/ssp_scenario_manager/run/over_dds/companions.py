"""The processes that run beside a session and aren't part of it: operators' page, shadow models."""

from __future__ import annotations

import json
import re
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.credentials import TOKEN_VARIABLE, check_token
from ssp_core.errors import InputError
from ssp_core.files.strict_json import parse_strict
from ssp_core.host.processes import NodeProcess, ProcessGroup
from ssp_core.run_file.verdict import EndWord

PAGE_MODULE = "ssp_monitor.ros.page_node"
DEFAULT_PORT = 8080
# A page that is told the end has heard it by then, and stays for its viewers or is gone.
LEFT_S = 2.0
_HEARD = re.compile(r"^page: heard the end", re.MULTILINE)
_STAYS = re.compile(r"^page: stays", re.MULTILINE)
_URL = re.compile(r"^page: (http://\S+/)$", re.MULTILINE)


def given_token(env: Mapping[str, str]) -> str:
    """Return the page's token from the environment; empty: one is to be made.

    Raises:
        InputError: it can't be one.
    """
    token = env.get(TOKEN_VARIABLE, "")
    return check_token(token, f"environment variable {TOKEN_VARIABLE}") if token else ""


@dataclass(frozen=True, slots=True)
class Companion:
    """A node that runs beside a session and is none of its own: page, shadow model.

    Args:
        what: for people.
        env: what its environment has besides.
        hint: for the address of a page, what belongs to its end.
        hears_the_end: it receives how the run ends, on standard input, and may stay to show it.
    """

    name: str
    module: str
    parameters: Mapping[str, object]
    what: str
    env: Mapping[str, str] = field(default_factory=dict)
    hint: str = ""
    hears_the_end: bool = False


def page_companion(env: Mapping[str, str], run_file: Path, port: int) -> Companion:
    """Return the operators' page.

    Args:
        env: of the process, which may hold the token.
        run_file: of the run that it shows.
        port: to listen on; 0: any.

    Raises:
        InputError: the token in SSP_PAGE_TOKEN can't be one.
    """
    env_token = given_token(env)
    token = env_token or secrets.token_urlsafe(24)
    return Companion(
        names.MONITOR_PAGE,
        PAGE_MODULE,
        {"run_file": run_file, "port": port, "led_by_runner": "true"},
        "the operator page",
        {TOKEN_VARIABLE: token},
        # Whoever chose the token knows it; it needs to stand in no log of a terminal.
        "" if env_token else f"#token={token}",
        hears_the_end=True,
    )


@contextmanager
def beside(
    session: ProcessGroup,
    companions: Sequence[Companion],
    say: Callable[[str], None],
    remappings: Sequence[str] = (),
) -> Iterator[Callable[[EndWord], None]]:
    """Run nodes as long as the block lasts; their processes aren't the session's own.

    A node that hears the end of the run, and has heard its final word, may stay to show it.

    Args:
        session: whose domain and log folder they share.
        companions: which; none starts nothing.
        say: tells the user a sentence.
        remappings: ``from:=to``, as the session's own nodes have them.

    Yields:
        What tells those that hear it how the run ends.
    """
    listeners: list[_Listener] = []

    def tell(word: EndWord) -> None:
        for listener in listeners:
            listener.tell(word)

    with ExitStack() as stack:
        for companion in companions:
            env = {**session.env, **companion.env}
            # The session's group alone may remove what is left of the domain.
            group = ProcessGroup(env, session.log_dir, owns_domain=False)
            parameters = dict(companion.parameters)
            node = group.start_node(
                companion.name,
                companion.module,
                parameters,
                remappings,
                pipe=companion.hears_the_end,
            )
            watch = threading.Thread(target=_watch, args=(companion, node, say), daemon=True)
            watch.start()
            listener = _Listener(node, group, watch, say)
            stack.callback(listener.leave)
            if companion.hears_the_end:
                listeners.append(listener)
        yield tell


@dataclass
class _Listener:
    """The process of a companion, which may receive the end of the run."""

    node: NodeProcess
    group: ProcessGroup
    watch: threading.Thread
    say: Callable[[str], None]
    has_final_word: bool = False

    def tell(self, word: EndWord) -> None:
        """Send the word; a process that has ended hears none."""
        self.node.expected_to_stop = self.has_final_word = word.final
        pipe = self.node.process.stdin
        if pipe is not None:
            with suppress(OSError, ValueError):
                pipe.write(word.line())
                pipe.flush()

    def leave(self) -> None:
        """End the process, unless it stays by itself to show the end.

        One that has heard the end and is slow to close is left alone, as it ends by itself; one
        that hasn't hangs. The run's verdict waits for neither.
        """
        if not self.has_final_word:
            self.group.stop()
            self.watch.join()
            return
        pid = self.node.process.pid
        deadline = time.monotonic() + LEFT_S
        while self.node.returncode is None and time.monotonic() < deadline:
            if self._has_logged(_STAYS):
                self.say(f"operator page: shows the end for a minute; `kill {pid}` ends it now")
                return
            time.sleep(0.02)
        if self.node.returncode is None and self._has_logged(_HEARD):
            self.say(f"operator page: hasn't closed yet; `kill -9 {pid}` ends it now")
            return
        if self.node.returncode is None:
            self.node.kill()
            self.say(f"operator page: didn't hear the end within {LEFT_S:g} s, and was ended")
        self.watch.join()

    def _has_logged(self, words: re.Pattern[str]) -> bool:
        return words.search(self.node.log.read_text(errors="replace")) is not None


def _watch(companion: Companion, node: NodeProcess, say: Callable[[str], None]) -> None:
    """Say where a page is, once it is there, and that a companion has ended, should it."""
    while companion.module == PAGE_MODULE and node.returncode is None:
        match = _URL.search(node.log.read_text(errors="replace"))
        if match is not None:
            say(f"operator page: {match[1]}{companion.hint}")
            break
        time.sleep(0.05)
    node.process.wait()
    if not node.expected_to_stop:
        tail = node.log_tail(3)
        say(
            f"{companion.what} {node.describe_exit()}; the session goes on without it"
            + (f": {tail}" if tail else "")
        )


SHADOW_MODULE = "ssp_vla_bridge.ros.vla_bridge"
DEFAULT_HZ = 2.0
# What the recorder is to take besides, so that the answers are in the bag.
RECORDED = "^/diagnostics$|^/ssp/vla/[^/]+/response$"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_OWN = ("backend", "interface", "timeout_s", "hz")


def shadow_model(text: str) -> Companion:
    """Read the model of ``NAME`` or ``NAME={"backend": …, "hz": …, further options}``.

    Raises:
        InputError: it is no such text.
    """
    name, _, options_text = text.partition("=")
    if not _NAME.fullmatch(name):
        raise InputError(
            "is no name for a topic",
            field="--shadow",
            value=name,
            remedy="use letters, digits and underscores, a letter first",
        )
    try:
        options: Any = parse_strict(options_text) if options_text.strip() else {}
    except ValueError as error:
        raise InputError(
            f"is not valid JSON: {error}",
            field="--shadow",
            value=options_text,
            remedy="""write --shadow 'NAME={"option": value}'""",
        ) from error
    if not isinstance(options, dict):
        raise InputError(
            "must be a JSON object",
            field="--shadow",
            value=options_text,
            remedy="""write --shadow 'NAME={"option": value}'""",
        )
    hz = options.get("hz", DEFAULT_HZ)
    if isinstance(hz, bool) or not isinstance(hz, int | float) or not 0.0 < hz <= 100.0:
        raise InputError(
            "must lie in (0, 100] Hz",
            field="--shadow hz",
            value=hz,
            remedy="give questions per second",
        )
    parameters: dict[str, object] = {"model": name, "shadow_hz": float(hz)}
    for key in ("backend", "interface"):
        if key in options:
            parameters[key] = str(options[key])
    if "timeout_s" in options:
        parameters["timeout_s"] = _seconds(options["timeout_s"])
    backend_options = {key: value for key, value in options.items() if key not in _OWN}
    if backend_options:
        # Parameter values are read as YAML; the quoted text stays one string.
        parameters["backend_options"] = json.dumps(json.dumps(backend_options))
    node = f"vla_bridge_{name}"
    return Companion(node, SHADOW_MODULE, parameters, f"the bridge of {name}")


def _seconds(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(
            "must be seconds", field="--shadow timeout_s", value=value, remedy="write a number"
        )
    return float(value)
