"""The operators' page beside a session: started with it, and never a reason for it to fail."""

from __future__ import annotations

import re
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from ssp_core import names
from ssp_core.credentials import TOKEN_VARIABLE, check_token
from ssp_core.processes import NodeProcess, ProcessGroup

MODULE = "ssp_monitor.ros.page_node"
DEFAULT_PORT = 8080
START_S = 15.0
_URL = re.compile(r"^page: (http://\S+/)$", re.MULTILINE)


def given_token(env: Mapping[str, str]) -> str:
    """The token that the environment has for the page; empty: one is to be made.

    Args:
        env: of the session.

    Raises:
        InputError: it can't be one.
    """
    given = env.get(TOKEN_VARIABLE, "")
    return check_token(given, f"environment variable {TOKEN_VARIABLE}") if given else ""


@contextmanager
def page_beside(
    session: ProcessGroup,
    run_file: Path,
    port: int | None,
    say: Callable[[str], None],
    remappings: Sequence[str] = (),
) -> Iterator[None]:
    """Has the page run as long as the block does; its process is none of the session's own.

    Args:
        session: whose domain and log folder the page shares.
        run_file: of the session.
        port: to listen on; 0: any; None: there is to be no page.
        say: takes one line for people per thing that happens.
        remappings: ``from:=to``, as the session's own nodes have them.

    Raises:
        InputError: the token in SSP_PAGE_TOKEN can't be one.
    """
    if port is None:
        yield
        return
    given = given_token(session.env)
    token = given or secrets.token_urlsafe(24)
    env = {**session.env, TOKEN_VARIABLE: token}
    # Whoever chose the token knows it; it needs to stand in no log of a terminal.
    shown = "" if given else f"#token={token}"
    # The session's group alone may remove what is left of the domain.
    with ProcessGroup(env, session.log_dir, owns_domain=False) as group:
        parameters: dict[str, object] = {"run_file": run_file, "port": port}
        node = group.start_node(names.MONITOR_PAGE, MODULE, parameters, remappings)
        watch = threading.Thread(target=_watch, args=(node, shown, say), daemon=True)
        watch.start()
        try:
            yield
        finally:
            group.stop()
            watch.join()


def _watch(node: NodeProcess, shown: str, say: Callable[[str], None]) -> None:
    """Says where the page is, once it is, and that it has ended, should it."""
    deadline = time.monotonic() + START_S
    while node.returncode is None and time.monotonic() < deadline:
        found = _URL.search(node.log.read_text(errors="replace"))
        if found is not None:
            say(f"operator page: {found[1]}{shown}")
            break
        time.sleep(0.05)
    node.process.wait()
    if not node.expected_to_stop:
        tail = node.log_tail(3)
        say(
            f"the operator page {node.describe_exit()}; the session goes on without it"
            + (f": {tail}" if tail else "")
        )
