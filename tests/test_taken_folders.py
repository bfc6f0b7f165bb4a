"""No command that writes several files shares its folder with another command."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_core.files.folders import taken_folder

SPEC_EXTRACT = "spec extract VIDEO --base-url http://127.0.0.1:9 --model m --name n"


@pytest.mark.parametrize(
    ("command", "folder"),
    [
        ("ablate cut_in --sites straight --out OUT", "OUT"),
        ("audit SYN SIM PHY --out OUT --force", "OUT"),
        ("extract TEXTS --review OUT", "OUT"),
        ("report --from-cells CELLS --out OUT", "OUT"),
        (f"{SPEC_EXTRACT} --out OUT", "OUT/n.extraction"),
    ],
)
def test_a_folder_that_another_command_writes_into_is_refused(
    command: str,
    folder: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("TEXTS").write_text('{"id": 1, "text": "A car brakes ahead."}\n')
    with taken_folder(folder):
        before = sorted(tmp_path.rglob("*"))
        assert main(command.split()) != 0
        assert "another command is writing into it" in capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before
