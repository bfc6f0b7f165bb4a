"""The process that node processes are forked from, which has imported what they need once.

A node that is started by itself imports rclpy, numpy and much of SSP for most of a second of
processor time, and a session has five nodes and more. This process imports the module of each node
that it is asked for, and forks; the node's process calls the module's ``main``.

Nothing may be running in it: a thread that held a lock at the fork would hold it in the node for
ever. So it starts no middleware. The only threads that importing a node's module starts are two of
LTTng, which comes with rclpy; they sleep until a tracing service calls, and a node needs none.

Requests and answers go over a socket that keeps messages whole (SOCK_SEQPACKET). A request is a
byte, and with it the file descriptors of a file with a JSON of ``Request``, of the node's output
and, where it has one, its standard input. An answer is a JSON: the ``pid`` of a node that was
forked, and with it a file descriptor of the process; and its ``pid`` and ``status``, as waitpid has
it, once it has ended. The end of the other side ends this process, and with it, by SIGTERM, the
nodes.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import selectors
import signal
import socket
import sys
import warnings
from contextlib import suppress
from dataclasses import dataclass, field

from ssp_core.host.children import call_process, die_with_parent
from ssp_core.host.terminal import end_at_once


@dataclass(frozen=True)
class Request:
    """A node to be started.

    Args:
        name: of the process, as ``ps -e`` and ``top`` show it (15 bytes).
        module: whose ``main`` is called.
        arguments: of its command line.
        environment: all variables that it has.
        folder: its working folder.
        imports: further modules, imported before the process is forked.
    """

    name: str
    module: str
    arguments: list[str]
    environment: dict[str, str]
    folder: str
    imports: list[str] = field(default_factory=list)


def serve(channel: socket.socket) -> Request | None:
    """Fork a process for each request, and say when each has ended.

    Args:
        channel: to whom asks.

    Returns:
        In a forked process: what it was asked for. In this one, once the other side is gone: None.
    """
    initial_variables = set(os.environ)
    pid_of: dict[int, int] = {}  # by file descriptor of the process
    with selectors.DefaultSelector() as selector:
        selector.register(channel, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fd in pid_of:
                    selector.unregister(key.fd)
                    os.close(key.fd)
                    pid, status = os.waitpid(pid_of.pop(key.fd), 0)
                    _answer(channel, pid=pid, status=status)
                    continue
                word, handed, *_ = socket.recv_fds(channel, 1, 3)
                if not word:
                    return None
                with open(handed[0], encoding="utf-8") as file:
                    request = Request(**json.load(file))
                # One that can't be imported says so in its own log, where it is imported again.
                for module in (request.module, *request.imports):
                    with suppress(BaseException):
                        importlib.import_module(module)
                here = os.getpid()
                gc.freeze()  # what is here stays, in pages that are shared as long as they are
                with warnings.catch_warnings():
                    # From Python 3.12 on, a fork beside any thread is warned of.
                    warnings.simplefilter("ignore", DeprecationWarning)
                    pid = os.fork()
                if not pid:
                    channel.close()
                    for descriptor in pid_of:
                        os.close(descriptor)
                    set_by_imports = {
                        name: value
                        for name, value in os.environ.items()
                        if name not in initial_variables
                    }
                    _become(request, set_by_imports, handed[1:], here)
                    return request
                for descriptor in handed[1:]:
                    os.close(descriptor)
                descriptor = os.pidfd_open(pid)
                pid_of[descriptor] = pid
                selector.register(descriptor, selectors.EVENT_READ)
                _answer(channel, descriptor, pid=pid)


def _answer(channel: socket.socket, *descriptors: int, **values: int) -> None:
    with suppress(OSError):  # nobody is there any more, as is found at the next look
        socket.send_fds(channel, [json.dumps(values).encode()], descriptors)


def _become(
    request: Request, set_by_imports: dict[str, str], output_and_input: list[int], parent: int
) -> None:
    """Make this process, just forked, that of the node."""
    os.setsid()
    die_with_parent()
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGTERM)
    call_process(request.name)
    output, *inputs = output_and_input
    source = inputs[0] if inputs else os.open(os.devnull, os.O_RDONLY)
    for descriptor, target in ((source, 0), (output, 1), (output, 2)):
        os.dup2(descriptor, target)
    os.close(source)
    os.close(output)
    os.environ.clear()
    os.environ.update({**set_by_imports, **request.environment})
    os.chdir(request.folder)
    sys.argv = [request.module, *request.arguments]


def main() -> None:
    """Serve on the socket whose file descriptor is this program's argument.

    A forked process ends without the interpreter's own end. This is registered before anything is
    imported: the first that is registered is called last.
    """
    status = 1
    atexit.register(lambda: end_at_once(status))
    request = serve(socket.socket(fileno=int(sys.argv[1])))
    try:
        status = 0 if request is None else importlib.import_module(request.module).main() or 0
    except SystemExit as stop:
        status = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        raise


if __name__ == "__main__":
    main()
