"""Fuzzes one target, led by what code each input reaches.

python tests/fuzz/run.py TARGET [--runs N] [--seed S] [--seconds T] [--found FOLDER]

The same number of runs with the same seed tries the same inputs. An input that fails is written
below FOLDER (``TARGET-crash-*``, ``-timeout-*``, ``-oom-*``) and the program ends with a status
other than 0.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
from pathlib import Path

import atheris

CORPUS = Path(__file__).parent / "corpus"
_MEMORY_MB = 2048
_TIMEOUT_S = 25

# What leads the fuzzer, by target: to follow all code would make it ten times as slow. Tables of
# known types are long and have no branch.
_BAG = ("ssp_core.bag", "mcap")
_YAML = ("ssp_core.bag", "ssp_core.files", "yaml")
_TYPES = ("ssp_core.bag", "rosbags.typesys", "rosbags.serde")
FOLLOWED = {
    "read": _BAG,
    "check": _BAG,
    "recover": _BAG,
    "cut": _BAG,
    "info": _BAG,
    "metadata": _YAML,
    "qos": _YAML,
    "wire": ("ssp_core.wire", "ssp_core.messages"),
    "types": _TYPES,
    "cdr": _TYPES,
    "run": ("ssp_core.fault_file", "ssp_core.run_spec", "ssp_core.files", "yaml"),
    "answer": ("ssp_vla_bridge.core",),
    "response": ("ssp_vla_bridge.core",),
    "extract": ("ssp_eval.extract",),
    "reply": ("ssp_eval.extract.llm", "ssp_core.strict_json"),
}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("target", choices=FOLLOWED)
    parser.add_argument("--runs", type=int, default=2000, help="inputs to try, -1: no limit")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=0, help="stop after this time, 0: don't")
    parser.add_argument("--found", type=Path, default=Path("fuzz_found"), help="for failing inputs")
    return parser.parse_args()


def main() -> None:
    given = arguments()
    sys.path.insert(0, str(Path(__file__).parent))
    with atheris.instrument_imports(
        include=list(FOLLOWED[given.target]), exclude=["rosbags.typesys.stores"]
    ):
        from targets import TARGETS
    target = TARGETS[given.target]
    regressions = sorted(CORPUS.glob(f"{given.target}-*"))
    given.found.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for data in [*target.seeds(), *(path.read_bytes() for path in regressions)]:
            Path(folder, hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
        options = [
            f"-runs={given.runs}",
            f"-seed={given.seed}",
            f"-max_total_time={given.seconds}",
            f"-max_len={target.most_bytes}",
            f"-timeout={_TIMEOUT_S}",
            f"-rss_limit_mb={_MEMORY_MB}",
            f"-artifact_prefix={given.found}/{given.target}-",
            "-print_final_stats=1",
        ]
        atheris.Setup([sys.argv[0], *options, folder], target.run)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
