"""A few runs of each fuzzing target, and the inputs that once failed; see README.md."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

RUN = Path(__file__).with_name("run.py")
# Few enough for every test run; the same inputs each time, since the seed is the same.
RUNS = {
    "wire": 3000,
    "types": 60,
    "cdr": 3000,
    "answer": 3000,
    "response": 1000,
    "extract": 1500,
    "reply": 1000,
}
SEED = 5


def test_no_input_gives_a_traceback(tmp_path: Path) -> None:
    targets = [f"{name}={runs}" for name, runs in RUNS.items()]
    done = subprocess.run(
        [sys.executable, str(RUN), *targets, "--seed", str(SEED), "--found", str(tmp_path)],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=600,
        check=False,
    )
    assert list(tmp_path.iterdir()) == [], done.stderr[-3000:]
    assert done.returncode == 0, done.stderr[-3000:] + done.stdout[-3000:]
    # The fuzzer may finish what it has begun: a run or two more.
    counts = re.findall(r"^target (\w+)$.*?^Done (\d+) runs", done.stderr, re.MULTILINE | re.DOTALL)
    assert [name for name, _ in counts] == list(RUNS)
    assert all(int(count) >= RUNS[name] for name, count in counts)


def test_a_failing_input_is_noticed(tmp_path: Path) -> None:
    """The runner reports what a target raises: here one that is made to fail."""
    broken = tmp_path / "broken.py"
    broken.write_text(
        f"import sys\nsys.path.insert(0, {str(RUN.parent)!r})\n"
        "import run, targets\nfrom dataclasses import replace\n"
        "def fail(data):\n    raise KeyError('found')\n"
        "targets.TARGETS['wire'] = replace(targets.TARGETS['wire'], run=fail)\n"
        f"sys.argv = ['run.py', 'wire', '--found', {str(tmp_path / 'found')!r}]\nrun.main()\n"
    )
    done = subprocess.run(
        [sys.executable, str(broken)], capture_output=True, timeout=600, check=False
    )
    assert done.returncode != 0
    assert b"KeyError" in done.stdout + done.stderr
    assert [p.name[:11] for p in (tmp_path / "found").iterdir()] == ["wire-crash-"]
