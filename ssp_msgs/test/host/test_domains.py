"""Two sessions never get the same ROS domain, and a domain that somebody uses is left alone."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from ssp_core.errors import HostError
from ssp_core.host import domains, locks, shared_memory
from ssp_core.host.domains import DOMAINS, free_domain
from ssp_core.host.ports import domain_ports, ports_in_use

# Takes a domain, says which, and gives it back when its standard input ends.
HOLDER = """
import sys
from pathlib import Path
from ssp_core.host import domains, locks
locks.LOCKS = Path(sys.argv[1])
with domains.free_domain() as domain_id:
    print(domain_id, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Locks of this test only; other sessions on this host keep theirs."""
    monkeypatch.setattr(locks, "LOCKS", tmp_path)


def test_ports_of_a_domain() -> None:
    """RTPS 2.2, 9.6.1.1: 7400 + 250 d for the first participant of domain d."""
    assert domain_ports(0) == range(7400, 7650)
    assert domain_ports(1).start == 7650
    assert not set(domain_ports(20)) & set(domain_ports(21))
    assert domain_ports(DOMAINS.stop - 1).stop <= 32768  # below Linux's ephemeral ports


def test_ports_in_use() -> None:
    text = (
        "  sl  local_address rem_address   st tx_queue rx_queue\n"
        "  123: 00000000:1CE8 00000000:0000 07 00000000:00000000 00:00000000\n"
        "  124: 0100007F:0035 00000000:0000 07 00000000:00000000 00:00000000\n"
        "\n"
        "  junk\n"
    )
    assert ports_in_use(text) == {7400, 53}
    assert ports_in_use("") == set()


def test_one_process_gets_different_ids_and_gives_them_back() -> None:
    with ExitStack() as stack:
        held = [stack.enter_context(free_domain()) for _ in range(10)]
        assert len(set(held)) == 10
        assert set(held) <= set(DOMAINS)
    with free_domain() as again:
        assert again == held[0]


def test_processes_get_different_ids_and_a_dead_one_gives_its_back(tmp_path: Path) -> None:
    held: list[int] = []
    processes = []
    try:
        for _ in range(6):
            process = subprocess.Popen(
                [sys.executable, "-c", HOLDER, str(tmp_path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            processes.append(process)
        for process in processes:
            assert process.stdout is not None
            held.append(int(process.stdout.readline()))
        assert len(set(held)) == len(held)
        with free_domain() as ours:
            assert ours not in held
        processes[0].kill()
        processes[0].wait(timeout=600)
    finally:
        for process in processes:
            process.kill()
            process.communicate(timeout=600)


def test_a_domain_with_an_open_port_is_skipped() -> None:
    with free_domain() as usual:
        pass
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", domain_ports(usual).start + 12))
        with free_domain() as other:
            assert other != usual


def test_a_port_that_a_participant_of_another_network_shares_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two sessions in one domain lost each other's answers for good; neither saw the other."""
    monkeypatch.setattr(shared_memory, "_SHM", tmp_path)
    with free_domain() as usual:
        pass
    with (tmp_path / f"fastrtps_port{domain_ports(usual).start + 10}_el").open("w") as listening:
        with free_domain() as again:
            assert again == usual
        fcntl.flock(listening, fcntl.LOCK_EX)
        with free_domain() as other:
            assert other != usual


def test_the_folder_that_tmpdir_names_holds_no_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be one command's own, and another's command would take the same domain."""
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "own"))
    (tmp_path / "own").mkdir()
    with free_domain():
        assert list((tmp_path / "own").iterdir()) == []


def test_a_folder_of_locks_that_cannot_be_made_is_said_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A host with a read-only /tmp is such a case; a session used to end there with a traceback."""
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(locks, "LOCKS", tmp_path / "file")
    words = r"file/ssp-domains, which .* can't be made: Not a directory; make it a folder"
    with pytest.raises(HostError, match=words), free_domain():
        pass


def test_locks_that_nobody_may_make_are_said_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(*_: object) -> int:
        raise OSError(errno.EROFS, "Read-only file system")

    (tmp_path / "ssp-domains").mkdir()
    monkeypatch.setattr(locks.os, "open", read_only)
    with pytest.raises(HostError, match=r"locks in .*ssp-domains can't be opened"), free_domain():
        pass


def test_all_taken_is_said_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    with free_domain() as only:
        monkeypatch.setattr(domains, "DOMAINS", range(only, only + 1))
        with pytest.raises(HostError, match="set ROS_DOMAIN_ID"), free_domain():
            pass


def test_a_lock_that_another_user_left_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a user of a host who has used all domains once keeps all others out for ever."""
    with free_domain() as usual:
        pass
    monkeypatch.setattr(domains, "DOMAINS", range(usual, usual + 1))
    real = os.open

    def only_to_read(path: os.PathLike[str], flags: int, *mode: int) -> int:
        if Path(path).name == str(usual) and flags != os.O_RDONLY:
            raise PermissionError
        return real(path, flags, *mode)

    monkeypatch.setattr(locks.os, "open", only_to_read)
    with free_domain() as again:
        assert again == usual
        with pytest.raises(HostError), free_domain():
            pass


def test_a_lock_that_cannot_be_read_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    with free_domain() as usual:
        pass
    real = os.open

    def not_ours(path: os.PathLike[str], *arguments: int) -> int:
        if Path(path).name == str(usual):
            raise PermissionError
        return real(path, *arguments)

    monkeypatch.setattr(locks.os, "open", not_ours)
    with free_domain() as other:
        assert other != usual


def test_the_folder_of_locks_is_for_all_users(tmp_path: Path) -> None:
    with free_domain():
        assert (tmp_path / "ssp-domains").stat().st_mode & 0o7777 == 0o1777
