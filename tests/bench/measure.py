"""The output of a benchmark: one JSON line per figure, read by ``ssp bench``."""

from __future__ import annotations

import json
import os
import subprocess
import sys

# `ssp bench --long`: loads that take minutes each.
LONG = bool(os.environ.get("SSP_BENCH_LONG"))


def percentile(values: list[float], share: float) -> float:
    """The value below which that share of the values lies, by the nearest rank."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def report(
    name: str,
    ours: float,
    bound: float | None,
    unit: str,
    note: str,
    *,
    lower: bool,
    ratio_limit: float | None = None,
    limit: float | None = None,
) -> None:
    """Prints a figure beside its bound, and the limit that it must keep.

    Args:
        name: what was measured.
        ours: the product's figure.
        bound: the lower bound's figure, same unit; None where there is none.
        unit: of both.
        note: sizes and counts that the figure depends on.
        lower: True where less is better. The ratio is always "times as bad as the bound".
        ratio_limit: the ratio must be at most that.
        limit: our figure must be at most that where less is better, else at least that.
    """
    ratio = None
    if bound is not None:
        ratio = ours / bound if lower else bound / ours
    kept, words = True, []
    if ratio is not None and ratio_limit is not None:
        kept = ratio <= ratio_limit
        words.append(f"ratio <= {ratio_limit:g}")
    if limit is not None:
        kept = kept and (ours <= limit if lower else ours >= limit)
        words.append(f"{'<=' if lower else '>='} {limit:g} {unit}")
    print(
        json.dumps(
            {
                "name": name,
                "ours": ours,
                "bound": bound,
                "unit": unit,
                "ratio": ratio,
                "limit": ", ".join(words) or None,
                "kept": kept,
                "note": note,
            }
        ),
        flush=True,
    )


def cost(arguments: list[str]) -> tuple[float, float]:
    """Processor time (s) and peak memory (MB) of a command, whatever it says."""
    process = subprocess.Popen(
        [sys.executable, "-m", "ssp_core.cli", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    told = process.stderr.read() if process.stderr is not None else ""
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if "Traceback" in told or process.returncode not in (0, 1):
        raise SystemExit(
            f"ssp {' '.join(arguments)} ended with {process.returncode}: {told[-500:]}"
        )
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3
