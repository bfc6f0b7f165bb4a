"""Node processes: a ROS domain of their own, a clean start, supervision, and an end in any case."""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.environment import isolated, require_sound
from ssp_core.errors import HostError

# Below 102 no DDS port of the domain lies in Linux's ephemeral range; the low ones are left to
# whoever chooses by hand.
DOMAINS = range(20, 101)


def domain_ports(domain_id: int) -> range:
    """Return the UDP ports that DDS participants of a domain may use (RTPS 2.2, 9.6.1.1)."""
    return range(7400 + 250 * domain_id, 7400 + 250 * (domain_id + 1))


def domain_of_port(port: int) -> int:
    """Return the domain that a DDS port belongs to."""
    return (port - 7400) // 250


def ports_in_use(proc_net_udp: str) -> set[int]:
    """Return the local UDP ports in the text of /proc/net/udp."""
    ports = set()
    for line in proc_net_udp.splitlines()[1:]:
        fields = line.split()
        if len(fields) > 1 and ":" in fields[1]:
            ports.add(int(fields[1].rsplit(":", 1)[1], 16))
    return ports


# Of what all commands of this host share; the folder that TMPDIR names may be one command's own.
LOCKS = Path("/tmp")


@contextmanager
def free_domain() -> Iterator[int]:
    """Yield a domain id that is free on this host, held by a file lock to the block's end.

    A container with a network of its own may share /dev/shm, over which participants of one domain
    reach each other; its ports aren't in /proc/net/udp.

    Raises:
        HostError: all of them are in use, or the folder of the locks can't be made.
    """
    folder = folder_of_domains()
    busy = _shared_ports()
    with suppress(OSError):
        busy |= ports_in_use(Path("/proc/net/udp").read_text())
    start = os.getpid() % len(DOMAINS)
    for k in range(len(DOMAINS)):
        domain_id = DOMAINS[(start + k) % len(DOMAINS)]
        if busy.intersection(domain_ports(domain_id)):
            continue
        try:
            handle = _open_lock(folder / str(domain_id))
        except OSError:  # another user's, who lets nobody read it, or nobody may make one
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            yield domain_id
        finally:
            os.close(handle)
        return
    raise HostError(
        f"all ROS domains from {DOMAINS.start} to {DOMAINS.stop - 1} are in use on this host, or "
        f"their locks in {folder} can't be opened; end other sessions, let every user make files "
        "there, or set ROS_DOMAIN_ID and start the nodes yourself"
    )


@contextmanager
def measuring_alone(say: Callable[[str], None]) -> Iterator[None]:
    """Keep other driven commands of this host waiting to the block's end, and wait for them.

    Args:
        say: takes a line for people where another command is waited for.

    Raises:
        HostError: the lock can't be opened.
    """
    path = _measuring_lock()
    try:
        lock = _open_pair(path)
    except OSError as error:
        raise HostError(
            f"{path}, the lock of commands that measure latencies, can't be opened: "
            f"{error.strerror}; make it a file that every user may read, in a folder in which "
            "every user may make one"
        ) from error
    words = (
        "another command drives, or measures latencies, on this host, and would disturb what this "
        f"one measures: it goes on when that has ended ({path} is the lock)"
    )
    with _held_in_turn(lock, fcntl.LOCK_EX, lambda: say(words)):
        yield


@contextmanager
def beside_measuring(say: Callable[[str], None]) -> Iterator[None]:
    """Wait while another command of this host measures latencies, and keep it waiting.

    Commands that measure none disturb each other in nothing that counts, and run side by side.
    Where the lock can't be opened, no command measures.

    Args:
        say: takes a line for people where another command is waited for.
    """
    path = _measuring_lock()
    try:
        lock = _open_pair(path)
    except OSError:
        yield
        return
    words = (
        "another command measures latencies on this host, and this one would disturb it: it goes "
        f"on when that has ended ({path} is the lock)"
    )
    with _held_in_turn(lock, fcntl.LOCK_SH, lambda: say(words)):
        yield


def _measuring_lock() -> Path:
    return LOCKS / "ssp-measuring" / "lock"


def _open_pair(path: Path) -> tuple[int, int]:
    """Open a lock, and the gate before it."""
    handle = _open_lock(path)
    try:
        return handle, _open_lock(path.with_name("gate"))
    except OSError:
        os.close(handle)
        raise


@contextmanager
def _held_in_turn(lock: tuple[int, int], kind: int, say: Callable[[], None]) -> Iterator[None]:
    """Hold a lock; ``say`` is called where it is waited for.

    Who waits for it keeps the gate shut, so that commands that share it don't go before one that
    wants it alone.
    """
    handle, gate = lock
    try:
        try:
            _lock_both(handle, kind | fcntl.LOCK_NB, gate, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say()
            _lock_both(handle, kind, gate, fcntl.LOCK_EX)
        finally:
            os.close(gate)
        yield
    finally:
        os.close(handle)


def _lock_both(handle: int, kind: int, gate: int, gate_kind: int) -> None:
    fcntl.flock(gate, gate_kind)
    fcntl.flock(handle, kind)


def folder_of_domains() -> Path:
    """Return the folder of the domains' locks, without which no session over ROS can be run.

    Raises:
        HostError: it can't be made.
    """
    return folder_of_locks("ssp-domains", ", or use --in-process")


def folder_of_locks(name: str, otherwise: str = "") -> Path:
    """Return a folder of locks of this host, made for all its users where there is none.

    Args:
        name: of the folder.
        otherwise: further remedy, at the end of the sentence.

    Raises:
        HostError: it can't be made.
    """
    folder = LOCKS / name
    try:
        _make_for_all(folder)
    except OSError as error:
        raise HostError(
            f"{folder}, which keeps commands of this host out of each other's way, can't be made: "
            f"{error.strerror}; make it a folder in which every user may make files{otherwise}"
        ) from error
    return folder


def _make_for_all(folder: Path) -> None:
    if not folder.is_dir():
        folder.mkdir(exist_ok=True)
        folder.chmod(0o1777)


def _open_lock(path: Path) -> int:
    """Open a file for locking, also one that another user left: reading it is enough."""
    _make_for_all(path.parent)
    try:
        handle = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        handle = os.open(path, os.O_CREAT | os.O_RDONLY, 0o644)
    # A umask would keep other users out.
    if os.fstat(handle).st_uid == os.geteuid():
        os.fchmod(handle, 0o644)
    return handle


_PR_SET_PDEATHSIG = 1
_SHM = Path("/dev/shm")
# A port, its mutex or the lock of who reads it; a participant that has just begun may have no lock.
_PORT = re.compile(r"(?:sem\.)?fastrtps_port(\d+)(?:_mutex|_el|_sl)?")
_NEW_S = 10.0
_MIN_FREE_SHM_BYTES = 512 << 20
_ONE_HOST = Path(__file__).parent / "config" / "fastdds_one_host.xml"
_ONE_HOST_UDP = _ONE_HOST.with_name("fastdds_one_host_udp.xml")
_ANSWER_S = 1.0
# A node's matrices are small, and threads for large ones cost each start 40 ms of a processor.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "1")


def check_shared_memory() -> None:
    """Refuse a /dev/shm in which nodes can't talk; without one they do it over UDP.

    Raises:
        HostError: it can't be written to.
    """
    if _SHM.is_dir() and not os.access(_SHM, os.W_OK | os.X_OK):
        raise HostError(
            f"{_SHM} must be writable, nodes on one host talk through it; mount it so "
            "(`mount -o remount,rw /dev/shm`, in Docker `--tmpfs /dev/shm`), or use --in-process"
        )


def session_environment(domain_id: int, profile: Path | None = None) -> dict[str, str]:
    """Return variables for node processes: loopback only, a domain of their own, our DDS profile.

    What this process was given to find others by is left out: with a discovery server, say, nodes
    meet whatever their domains are, and a simulated session would reach a live one.

    Args:
        domain_id: ROS domain, held by ``free_domain``.
        profile: Fast DDS profile with a large shared-memory segment, None for the shipped one; left
            out where /dev/shm is too small for it (a container's default is 64 MB), since a write
            beyond its end kills the process.

    Raises:
        HostError: /dev/shm can't be written to.
    """
    check_shared_memory()
    env = isolated(os.environ)
    env["ROS_DOMAIN_ID"] = str(domain_id)
    env["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    env["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    env["PYTHONUNBUFFERED"] = "1"
    env.setdefault(*_ONE_THREAD)
    if _SHM.is_dir() and shutil.disk_usage(_SHM).free > _MIN_FREE_SHM_BYTES:
        env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile or _ONE_HOST)
    return env


def without_shared_memory(env: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a session for a process that outlives it and needs no large messages.

    A node that is killed may leave a port in shared memory in the middle of a change, and Fast DDS
    then waits for it without end, with Python's lock held, when another takes its participant down.
    Over UDP nothing of a dead node can be waited for. A user's own profile stays.
    """
    if env.get("FASTRTPS_DEFAULT_PROFILES_FILE", str(_ONE_HOST)) != str(_ONE_HOST):
        return dict(env)
    return {
        **env,
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(_ONE_HOST_UDP),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
    }


def live_environment(profile: Path) -> dict[str, str]:
    """Return the variables for the nodes of a live session.

    They keep the ROS domain, the discovery and the DDS profile that this process was started with,
    since others on other hosts share them.

    Args:
        profile: Fast DDS profile for where the environment names none.

    Raises:
        InputError: with these variables no node could start, or none would meet another.
        HostError: /dev/shm can't be written to.
    """
    check_shared_memory()
    require_sound(os.environ, asks_servers=True)
    env = dict(os.environ)
    env["ROS_DOMAIN_ID"] = env.get("ROS_DOMAIN_ID") or "0"
    env.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    if not env.get("FASTRTPS_DEFAULT_PROFILES_FILE"):
        env["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
    if env.get("ROS_DISCOVERY_SERVER"):
        # A discovery server tells its clients of nobody that they don't talk to: a second manager,
        # say. A super client hears of everybody.
        env.setdefault("ROS_SUPER_CLIENT", "TRUE")
    env["PYTHONUNBUFFERED"] = "1"
    env.setdefault(*_ONE_THREAD)
    return env


# Loaded here: between fork and exec as little as possible may happen.
_LIBC = ctypes.CDLL(None)


def die_with_parent() -> None:
    """Let a child receive SIGTERM when its parent dies, however that happens.

    For its preexec_fn.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def outlive_parent() -> None:
    """Let this process go on after the parent that it was to die with."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, 0)


@dataclass
class NodeProcess:
    """One node in a process (and a process group) of its own, its output in a log file."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    expected_to_stop: bool = False

    @property
    def returncode(self) -> int | None:
        return self.process.poll()

    def describe_exit(self) -> str:
        """Describe for people how it ended."""
        code = self.returncode
        if code is None:
            return "still running"
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"exited with status {code}"

    def kill(self) -> None:
        """End it at once; one that hangs writes its stacks into its log first (faulthandler)."""
        self.expected_to_stop = True
        self.process.send_signal(signal.SIGABRT)
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_ANSWER_S)
        with suppress(ProcessLookupError):  # the last of the group may be gone by now
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def log_tail(self, lines: int = 12) -> str:
        try:
            return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


@dataclass
class ProcessGroup:
    """The node processes of one session; leaving the block ends every one of them.

    Args:
        processes: by node name.
        owns_domain: no other session is in the ROS domain, so that its remains may be removed.
    """

    env: dict[str, str]
    log_dir: Path
    processes: dict[str, NodeProcess] = field(default_factory=dict)
    owns_domain: bool = True

    def __enter__(self) -> ProcessGroup:
        self.log_dir.mkdir(parents=True, exist_ok=True)
        remove_stale_shared_memory()  # of a session that was killed with all its processes
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        remove_stale_shared_memory()
        if self.owns_domain:
            remove_shared_ports(int(self.env["ROS_DOMAIN_ID"]))

    def start_node(
        self,
        name: str,
        module: str,
        parameters: dict[str, object],
        remappings: Sequence[str] = (),
        *,
        pipe: bool = False,
    ) -> NodeProcess:
        """Start ``python -m module`` as a ROS node with parameters and remappings ``from:=to``.

        It receives SIGTERM when this process dies, however that happens, and no SIGINT from the
        terminal: the session's runner ends it in order.

        Args:
            name: of the node, and of its log.
            module: its Python module.
            parameters: values by name, as ``--ros-args -p`` takes them.
            remappings: each as ``from:=to``.
            pipe: its standard input is a pipe from here; otherwise it has none.
        """
        arguments = [sys.executable, "-m", module, "--ros-args", "-r", f"__node:={name}"]
        for key, value in parameters.items():
            arguments += ["-p", f"{key}:={value}"]
        for rule in remappings:
            arguments += ["-r", rule]
        log = self.log_dir / f"{name}.log"
        with log.open("ab") as stream:
            process = subprocess.Popen(
                arguments,
                env=self.env,
                stdin=subprocess.PIPE if pipe else subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )
        node = NodeProcess(name, process, log)
        self.processes[name] = node
        return node

    def ended(self) -> list[NodeProcess]:
        """List the processes that have ended without having been asked to."""
        return [
            node
            for node in self.processes.values()
            if node.returncode is not None and not node.expected_to_stop
        ]

    def stop(self, timeout_s: float = 20.0) -> list[str]:
        """Send SIGTERM to all that live, suspended ones too, and SIGKILL to those that don't react.

        Returns:
            Names of the processes that had to be killed.
        """
        alive = [node for node in self.processes.values() if node.returncode is None]
        for node in alive:
            node.expected_to_stop = True
            node.process.terminate()
            node.process.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + timeout_s
        killed = []
        for node in alive:
            try:
                node.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                node.kill()
                killed.append(node.name)
        return killed


def remove_shared_ports(domain_id: int) -> None:
    """Remove what killed participants of a domain leave of their ports in /dev/shm.

    Only for a domain that the caller holds and in which nothing runs any more.
    """
    for port in domain_ports(domain_id):
        for name in (f"fastrtps_port{port}", f"sem.fastrtps_port{port}_mutex"):
            (_SHM / name).unlink(missing_ok=True)


def remove_stale_shared_memory() -> int:
    """Remove what dead participants left of Fast DDS in /dev/shm; return how many segments.

    Each segment has a lock file (``…_el``) that its owner holds locked while it lives, as
    ``fastdds shm clean`` knows too. So have the ports at which it listens (``…_el``, ``…_sl``), but
    not those that it only wrote to: a port goes when no process locks one in its domain and nothing
    in there is new. Neither does a new segment go: its owner makes the lock file, then locks it.
    What is another user's is left alone.
    """
    removed = 0
    for lock in _SHM.glob("fastrtps_*_el"):
        if _PORT.fullmatch(lock.name):
            continue
        with suppress(FileNotFoundError), _locked(lock) as is_free:
            if is_free and not _is_new([lock]):
                (_SHM / lock.name.removesuffix("_el")).unlink(missing_ok=True)
                lock.unlink(missing_ok=True)
                removed += 1
    domains: dict[int, list[Path]] = {}
    for file in _SHM.glob("*fastrtps_port*"):
        if found := _PORT.fullmatch(file.name):
            domains.setdefault(domain_of_port(int(found[1])), []).append(file)
    for files in domains.values():
        _remove_dead_ports(files)
    return removed


def _shared_ports() -> set[int]:
    """Return the ports in /dev/shm at which a participant listens, wherever its network is."""
    found = set()
    for file in _SHM.glob("fastrtps_port*_[es]l"):
        with _locked(file) as is_free:
            if (port := _PORT.fullmatch(file.name)) and not is_free:
                found.add(int(port[1]))
    return found


def _remove_dead_ports(files: Sequence[Path]) -> None:
    """Remove all ports of a domain, unless one of them is locked, new or another user's.

    The locks are held meanwhile: who comes just now and finds its lock taken or gone tries again.
    """
    with ExitStack() as held, suppress(OSError):
        locks = [file for file in files if file.name.endswith(("_el", "_sl"))]
        for lock in locks:
            if not held.enter_context(_locked(lock)):
                return
        owners = {file.stat().st_uid for file in files}
        if not _is_new(files) and owners == {os.geteuid()}:
            for file in files:
                file.unlink(missing_ok=True)


def _is_new(files: Sequence[Path]) -> bool:
    return time.time() - max(file.stat().st_mtime for file in files) <= _NEW_S


@contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Lock a segment's file: False where its owner lives, or where it is gone."""
    try:
        handle = os.open(path, os.O_RDWR)
    except OSError:
        yield False
        return
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_free = True
        except OSError:
            is_free = False
        yield is_free
    finally:
        os.close(handle)
