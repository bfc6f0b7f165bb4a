"""Set-up: what is made anew when the lock changes, and downloads behind a certificate authority
of one's own."""

from __future__ import annotations

import base64
import hashlib
import http.server
import importlib.util
import os
import shutil
import ssl
import subprocess
import sys
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

BOOTSTRAP = Path(__file__).resolve().parent.parent / "bootstrap" / "bootstrap.py"
# Where the system keeps the authorities that it trusts, by distribution.
SYSTEM_FILES = ("/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt")
# What names authorities to uv, pip and others.
NAMING = ("SSL_CERT_FILE", "SSL_CERT_DIR", "PIP_CERT", "UV_SYSTEM_CERTS", "UV_NATIVE_TLS")
WHEEL = "trusted-1.0-py3-none-any.whl"


@pytest.fixture
def setup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script of the set-up, working in a folder of its own."""
    found = importlib.util.spec_from_file_location("bootstrap_under_test", BOOTSTRAP)
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(module, "LOG", tmp_path / "log" / "bootstrap.log")
    (tmp_path / "bootstrap").mkdir()
    for name in ("uv.lock", "requirements.lock"):
        (tmp_path / "bootstrap" / name).write_text("before\n")
    return module


@pytest.fixture
def built(setup: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is set up; installing is left out."""

    def run(command: list[str], what: str, env: object = None) -> None:
        if "venv" in command:
            (tmp_path / ".venv" / "lib" / "python3.12" / "site-packages").mkdir(parents=True)

    monkeypatch.setattr(setup, "run", run)
    monkeypatch.setattr(setup, "install_lock", lambda lock: None)
    setup.make_venv()
    for name in ("build/ssp_msgs/CMakeCache.txt", "install/lib/libssp_msgs.so", "log/old.log"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("made with the lock of before")
    return tmp_path


@pytest.mark.parametrize("changed", ["uv.lock", "requirements.lock"])
def test_what_was_built_with_another_lock_is_built_anew(
    setup: ModuleType, built: Path, changed: str
) -> None:
    setup.make_venv()
    assert (built / "build" / "ssp_msgs" / "CMakeCache.txt").exists()  # the same lock
    (built / "bootstrap" / changed).write_text("after\n")
    setup.make_venv()
    assert not (built / "build").exists()
    assert not (built / "install").exists()
    assert (built / "log" / "old.log").exists()


def test_what_another_python_built_is_built_anew(
    setup: ModuleType, built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "version", "3.99.0 (of another day)")
    setup.make_venv()
    assert not (built / "build").exists()
    assert not (built / "install").exists()


def openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


@dataclass(frozen=True)
class Index:
    """A package index on this host.

    Args:
        url: of its packages.
        authority: certificate of the authority that vouches for it.
        lock: names its package by hash.
    """

    url: str
    authority: Path
    lock: Path


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    """An index whose certificate only its own authority vouches for."""
    made = tmp_path / "index"
    made.mkdir()
    new = ("req", "-newkey", "rsa:2048", "-nodes", "-subj")
    # uv takes no authority for a server: two certificates.
    openssl(made, *new, "/CN=own authority", "-x509", "-keyout", "ca.key", "-out", "ca.crt")
    openssl(made, *new, "/CN=127.0.0.1", "-keyout", "server.key", "-out", "server.csr")
    (made / "names").write_text("subjectAltName=IP:127.0.0.1\n")
    openssl(
        made,
        "x509",
        "-req",
        "-in",
        "server.csr",
        "-CA",
        "ca.crt",
        "-CAkey",
        "ca.key",
        "-CAcreateserial",
        "-extfile",
        "names",
        "-out",
        "server.crt",
    )
    digest = wheel(made / "simple" / "trusted" / WHEEL)
    (made / "simple" / "trusted" / "index.html").write_text(f'<a href="{WHEEL}">{WHEEL}</a>')
    lock = tmp_path / "bootstrap" / "own.lock"
    lock.parent.mkdir(exist_ok=True)
    lock.write_text(f"trusted==1.0 --hash=sha256:{digest}\n")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), lambda *given: Quiet(*given, directory=str(made))
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(made / "server.crt", made / "server.key")
    server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield Index(f"https://127.0.0.1:{server.server_port}/simple", made / "ca.crt", lock)
    server.shutdown()
    thread.join()
    server.server_close()


def wheel(file: Path) -> str:
    """Writes a wheel of one module; its SHA-256."""
    info = "trusted-1.0.dist-info"
    files = {
        "trusted.py": "",
        f"{info}/METADATA": "Metadata-Version: 2.1\nName: trusted\nVersion: 1.0\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(
        f"{name},sha256={base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).decode().rstrip('=')},{len(text)}\n"
        for name, text in files.items()
    )
    file.parent.mkdir(parents=True)
    with zipfile.ZipFile(file, "w") as packed:
        for name, text in {**files, f"{info}/RECORD": f"{record}{info}/RECORD,,\n"}.items():
            packed.writestr(name, text)
    return hashlib.sha256(file.read_bytes()).hexdigest()


# Installs as the set-up does, where the system trusts an authority of one's own beside others.
INSTALL = """
import pathlib, sys
sys.path.insert(0, sys.argv[1])
import bootstrap
bootstrap.ROOT, bootstrap.VENV = pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[2], ".venv")
bootstrap.LOG = bootstrap.ROOT / "log" / "bootstrap.log"
try:
    bootstrap.install_lock(pathlib.Path(sys.argv[3]))
except bootstrap.BootstrapError as error:
    sys.exit(str(error))
"""


def install(folder: Path, index: Index, trusted_by_system: Path | None, **named: str) -> str:
    """Installs the index's package as the set-up does; what it says where it fails.

    Args:
        trusted_by_system: takes the place of the system's own list.
        named: variables of the environment.
    """
    uv = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    if uv is None:
        pytest.skip("not the environment of ./ssp: there is no uv")
    made = [uv, "venv", "--quiet", "--clear", "--python", sys.executable, str(folder / ".venv")]
    subprocess.run(made, check=True)
    (folder / ".venv" / "bin" / "uv").symlink_to(uv)
    env = {k: v for k, v in os.environ.items() if k not in NAMING and not k.startswith("UV_")}
    env |= {"UV_DEFAULT_INDEX": index.url, "UV_CACHE_DIR": str(folder / "cache"), **named}
    command = [sys.executable, "-c", INSTALL, str(BOOTSTRAP.parent), str(folder), str(index.lock)]
    if trusted_by_system is not None:
        mounts = "; ".join(f'[ ! -e {file} ] || mount --bind "$0" {file}' for file in SYSTEM_FILES)
        own = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"])]
        command = [
            *own,
            "sh",
            "-c",
            f'set -e; {mounts}; exec "$@"',
            str(trusted_by_system),
            *command,
        ]
        if subprocess.run([*own, "true"], capture_output=True, check=False).returncode:
            pytest.skip("no mount namespace may be made here")
    done = subprocess.run(
        command, env=env, capture_output=True, text=True, timeout=600, check=False
    )
    installed = list((folder / ".venv").glob("lib/python3.*/site-packages/trusted.py"))
    assert bool(installed) == (done.returncode == 0), done.stderr
    return done.stderr


@pytest.mark.parametrize("known_by", ["the system", "SSL_CERT_FILE", "PIP_CERT"])
def test_packages_are_had_behind_an_authority_of_ones_own(
    tmp_path: Path, index: Index, known_by: str
) -> None:
    if known_by == "the system":
        assert install(tmp_path, index, index.authority) == ""
    else:
        assert install(tmp_path, index, None, **{known_by: str(index.authority)}) == ""


def test_an_authority_that_nobody_knows_is_refused(tmp_path: Path, index: Index) -> None:
    said = install(tmp_path, index, None)
    assert "installing bootstrap/own.lock failed" in said
    assert "certificate" in said
