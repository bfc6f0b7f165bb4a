"""Fuzzes targets one after another, led by what code each input reaches.

python tests/fuzz/run.py TARGET[=N] ... [--runs N] [--seed S] [--seconds T] [--found FOLDER]

The same targets, numbers of runs and seed try the same inputs. An input that fails is written
below FOLDER (``TARGET-crash-*``, ``-timeout-*``, ``-oom-*``) and the program ends with a status
other than 0.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import tempfile
from pathlib import Path

import atheris

CORPUS = Path(__file__).parent / "corpus"
_MEMORY_MB = 2048
_TIMEOUT_S = 25

# What leads the fuzzer, by target: to follow all code would make it ten times as slow. Tables of
# known types are long and have no branch.
_TYPES = ("ssp_core.bag", "rosbags.typesys", "rosbags.serde")
_BRIDGE = (
    "ssp_vla_bridge.adapters",
    "ssp_vla_bridge.messages",
    "ssp_vla_bridge.native_history",
    "ssp_vla_bridge.backends.recorded",
    "ssp_vla_bridge.trajectory",
)
FOLLOWED = {
    "wire": ("ssp_core.cdr",),
    "types": _TYPES,
    "cdr": _TYPES,
    "answer": _BRIDGE,
    "response": _BRIDGE,
    "extract": ("ssp_eval.extract",),
    "reply": ("ssp_eval.extract.llm", "ssp_core.files.reading"),
}


def _target(text: str) -> tuple[str, int | None]:
    """TARGET or TARGET=RUNS."""
    name, _, runs = text.partition("=")
    if name not in FOLLOWED:
        raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(FOLLOWED)}")
    return name, int(runs) if runs else None


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("targets", nargs="+", type=_target, metavar="TARGET[=RUNS]")
    parser.add_argument("--runs", type=int, default=2000, help="inputs to try, -1: no limit")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=0, help="stop after this time, 0: don't")
    parser.add_argument("--found", type=Path, default=Path("fuzz_found"), help="for failing inputs")
    return parser.parse_args()


def main() -> None:
    given = arguments()
    sys.path.insert(0, str(Path(__file__).parent))
    followed = {module for name, _ in given.targets for module in FOLLOWED[name]}
    with atheris.instrument_imports(include=sorted(followed), exclude=["rosbags.typesys.stores"]):
        from targets import TARGETS
    given.found.mkdir(parents=True, exist_ok=True)
    failed = 0
    for name, runs in given.targets:
        with tempfile.TemporaryDirectory() as folder:
            seeds = TARGETS[name].seeds()
            regressions = (path.read_bytes() for path in sorted(CORPUS.glob(f"{name}-*")))
            for data in (*seeds, *regressions):
                Path(folder, hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
            options = [
                f"-runs={given.runs if runs is None else runs}",
                f"-seed={given.seed}",
                f"-max_total_time={given.seconds}",
                f"-max_len={TARGETS[name].most_bytes}",
                f"-timeout={_TIMEOUT_S}",
                f"-rss_limit_mb={_MEMORY_MB}",
                f"-artifact_prefix={given.found}/{name}-",
                "-print_final_stats=1",
            ]
            # libFuzzer ends its process; imports and instrumentation are paid for once.
            child = os.fork()
            if child == 0:
                print(f"target {name}", file=sys.stderr, flush=True)
                atheris.Setup([sys.argv[0], *options, folder], TARGETS[name].run)
                atheris.Fuzz()
                os._exit(0)
            failed = failed or os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    sys.exit(min(abs(failed), 255))


if __name__ == "__main__":
    main()
