"""A language model with weights behind a local server, for tests that are marked ``real_model``."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ssp_eval.checkout import MODEL_VARIABLE
from tests.real_model.install import PACKAGES, WEIGHTS

HERE = Path(__file__).parent
MARKER = "real_model"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave these tests out of every run that doesn't ask for their marker."""
    if MARKER in config.option.markexpr:
        return
    left_out = [item for item in items if item.get_closest_marker(MARKER)]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]


@pytest.fixture(scope="session")
def model_url() -> Iterator[str]:
    """Address of the server; it takes about a second to start and 0.4 GB of memory."""
    if MODEL_VARIABLE not in os.environ:
        pytest.fail("`./ssp test --real-model` downloads the model and starts these tests")
    folder = Path(os.environ[MODEL_VARIABLE])
    command = [sys.executable, HERE / "server.py", folder / PACKAGES, folder / WEIGHTS]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), "the server didn't start"
        yield address
        server.stdin.close()
