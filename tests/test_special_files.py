"""No command waits for, or drinks without end from, what is given to it as a file and is none."""

from __future__ import annotations

import os
import shutil
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from tests.support.processes.waiting import DEADLINE_S
from tests.support.rows import check_rows

# Longer than any refusal takes on a busy machine; what waits would do so for ever.
COMMANDS = (
    "spec check FILE",
    "spec diff FILE FILE",
    "compile FILE --target sumo --site boulevard --out OUT",
    "compile cut_in --target track --site FILE --out OUT",
    "compile cut_in --target sumo --map FILE --out OUT",
    "compile cut_in --target track --site boulevard --shortlist FILE --out OUT",
    "run FILE --out OUT",
    "import-bag FILE --vut /a --object ot1=/b:car --camera /c --domain physical --out OUT",
    "import-video FILE --ego-unknown --out OUT",
    "import-video CLIP --states FILE --out OUT",
    "labels check FILE",
    "labels new FILE",
    "audit FILE FILE FILE --out OUT",
    "evaluate FILE --bridge silent --out OUT",
    "evaluate BAG --models FILE --out OUT",
    "evaluate BAG --bridge silent --audit FILE --out OUT",
    "evaluate BAG --bridge silent --thresholds FILE --out OUT",
    "evaluate BAG --bridge silent --labels FILE --out OUT",
    "score FILE FILE",
    "report FILE",
    "report --from-cells FILE --out OUT",
    "shortlist FILE FILE",
    "extract FILE",
    "extract --measure FILE",
    "package make FILE --out OUT",
    "package verify FILE",
    "bag info FILE",
    "bag check FILE",
    "bag recover FILE --out OUT",
    "bag cut FILE --out OUT",
    "bag export FILE --csv --out OUT",
    "replay FILE",
)
KINDS = ("pipe", "link to a pipe", "folder", "device", "socket", "bag of a pipe")


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    root = tmp_path_factory.mktemp("special")
    os.mkfifo(root / "pipe")
    (root / "link").symlink_to(root / "pipe")
    for name in ("folder", "bag"):
        (root / name).mkdir()
    os.mkfifo(root / "bag" / "bag_0.mcap")
    writer = cv2.VideoWriter(str(root / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for k in range(5):
        writer.write(np.full((48, 64, 3), k, np.uint8))
    writer.release()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(root / "socket"))
        names = ("pipe", "link", "folder", "/dev/zero", "socket", "bag")
        yield {kind: root / name for kind, name in zip(KINDS, names, strict=True)} | {
            "CLIP": root / "a.avi",
            "OUT": root / "out",
        }


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_no_file_is_refused(
    command: str, places: dict[str, Path], capfd: pytest.CaptureFixture[str]
) -> None:
    def check(kind: str) -> None:
        words = {"FILE": places[kind], "BAG": places["folder"], **places}
        arguments = [str(words.get(word, word)) for word in command.split()]

        def expired(*_: object) -> None:
            raise AssertionError(f"{arguments} waits")

        before = signal.signal(signal.SIGALRM, expired)
        signal.alarm(int(DEADLINE_S))
        try:
            status = main(arguments)
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)
            shutil.rmtree(places["OUT"], ignore_errors=True)
        told = capfd.readouterr()
        assert status == 1, told.err
        assert "Traceback" not in told.err

    check_rows(check, [(kind,) for kind in KINDS])
