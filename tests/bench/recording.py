"""Recording end to end: is everything in the bag, what does it cost, and when does it break.

One process publishes (``traffic``), another one records it with ``ssp bag record``; in the same run
the same load goes to a subscriber that throws everything away (``discard``). What was lost is
counted twice: against what the publishers say they sent, and by the gaps in what the bag holds. At
last the load is raised until something is lost, or until the publishing process can't keep its
rate, in short runs.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from measure import LONG, report
from traffic import Load

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import leading_stamp_ns
from ssp_core.errors import HostError
from ssp_core.host.children import die_with_parent
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from ssp_scenario_manager.run.over_dds.session import PROFILE

HERE = Path(__file__).parent
LOADS = (
    Load(jpegs=4, objects=20),
    *([Load(objects=100)] if LONG else []),
    Load(raws=2, objects=20),
)
SECONDS = 60.0 if LONG else 8.0
RATIO_LIMIT = 2.2
# What is still on its way to the disk when the last message was sent is paid for too.
AFTER_S = 1.5
STOP_TIMEOUT_S = 120.0
# A publishing process below this share of its rate is what gave in.
HELD = 0.97
SEARCH_S = 5.0
SEARCH_STEPS = 3
# A bag and what lies around it; the recorder ends when less than 0.2 GB would be left.
DISK_SHARE, DISK_RESERVE_BYTES = 1.1, 1_000_000_000
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Ran:
    """One process under one load.

    Args:
        cpu_share: of one core, from the first message to a little after the last.
        sent: messages by topic.
        held: share of the rate that the publishing process kept.
        told: the last line that the process printed.
    """

    cpu_share: float
    sent: dict[str, int]
    held: float
    told: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Missing:
    """The messages that a bag lacks.

    Args:
        by_count: sent and not there.
        by_gaps: numbers that are not there, of those between the first and the last.
        wrong: messages with another number than the one that they were sent with.
    """

    by_count: int
    by_gaps: int
    wrong: int

    @property
    def total(self) -> int:
        return max(self.by_count, self.by_gaps) + self.wrong


def cpu_s(pid: int) -> float:
    """Processor time of a process and its threads so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


@contextmanager
def process(arguments: Sequence[str], env: dict[str, str], log: Path) -> Iterator[Any]:
    """A Python process with its input and output, gone at the end of the block."""
    with log.open("ab") as stream:
        started = subprocess.Popen(
            [sys.executable, *arguments],
            cwd=HERE,
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stream,
            text=True,
            preexec_fn=die_with_parent,
        )
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def line_of(started: Any, log: Path) -> dict[str, Any]:
    """The next JSON line of a process.

    Raises:
        HostError: it ended instead.
    """
    for line in started.stdout:
        if line.startswith("{"):
            return dict(json.loads(line))
    raise HostError(f"a process of the benchmark ended: {log.read_text()[-2000:]}")


def under(load: Load, seconds: float, arguments: Sequence[str], folder: Path, **more: str) -> Ran:
    """Runs a process, with more in its environment, and the load for it."""
    with free_domain() as domain_id:
        env = session_environment(domain_id, PROFILE) | more
        log = folder / "log.txt"
        traffic = ["traffic.py", load.to_json(), str(seconds)]
        try:
            with process(arguments, env, log) as ours, process(traffic, env, log) as publishing:
                line_of(publishing, log)
                begun_s, before_s = time.monotonic(), cpu_s(ours.pid)
                sent = line_of(publishing, log)["sent"]
                time.sleep(AFTER_S)
                used_s = cpu_s(ours.pid) - before_s
                span_s = time.monotonic() - begun_s - AFTER_S
                # Before the publishers go: what they have not delivered yet can still be taken.
                ours.send_signal(signal.SIGINT)
                ours.stdin.close()
                told = line_of(ours, log)
                ours.wait(STOP_TIMEOUT_S)
        finally:
            remove_stale_shared_memory()
            remove_shared_ports(domain_id)
    held = sum(sent.values()) / (load.messages_per_s * seconds)
    return Ran(used_s / max(span_s, seconds), sent, held, told)


def discarded(load: Load, seconds: float) -> Ran:
    """The bound. It keeps the memory that it has: to return it and fetch it anew for each large
    message, as malloc does in some runs and not in others, triples what it takes.
    """
    keep = str(1 << 30)
    memory = {"MALLOC_MMAP_THRESHOLD_": keep, "MALLOC_TRIM_THRESHOLD_": keep}
    with tempfile.TemporaryDirectory() as folder:
        return under(load, seconds, ["discard.py", load.to_json()], Path(folder), **memory)


def recorded(load: Load, seconds: float, folder: Path) -> tuple[Ran, Missing]:
    """Records a load and counts what is missing; the bag is removed.

    Raises:
        HostError: the disk has too little room.
    """
    needed = int(DISK_SHARE * load.bytes_per_s * seconds) + DISK_RESERVE_BYTES
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise HostError(
            f"{folder} has {free / 1e9:.1f} GB left and {load} for {seconds:g} s needs "
            f"{needed / 1e9:.1f} GB; name another place with --folder, or a shorter time with "
            "--seconds"
        )
    with tempfile.TemporaryDirectory(dir=folder) as inside:
        bag = Path(inside) / "bag"
        arguments = ["-m", "ssp_core.cli", "bag", "record", "--json", "-o", str(bag)]
        arguments += ["--include", f"^{names.NAMESPACE}/bench/"]
        ran = under(load, seconds, arguments, Path(inside))
        return ran, missing(bag, ran.sent)


def missing(bag: Path, sent: dict[str, int]) -> Missing:
    """Reads a bag and compares it with what was sent: counts, sequence numbers and contents."""
    counts = dict.fromkeys(sent, 0)
    first: dict[str, int] = {}
    last: dict[str, int] = {}
    gaps = wrong = 0
    with BagReader(bag) as reader:
        for topic, _, _, data, sequence in reader.messages(list(sent)):
            counts[topic] += 1
            first.setdefault(topic, sequence)
            gaps += sequence - last.get(topic, sequence - 1) - 1
            last[topic] = sequence
            # The bytes are those that were sent under this number.
            wrong += leading_stamp_ns(data) != sequence
    return Missing(sum(sent.values()) - sum(counts.values()), gaps, wrong)


# -- the load at which it breaks -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Break:
    """The load at which a growing load breaks.

    Args:
        good: the highest that was recorded whole, None where none was.
        bad: the lowest that was not.
        why: which of the two processes gave in, and how.
    """

    good: Load | None
    bad: Load
    why: str


def gave_in(load: Load, folder: Path) -> str:
    """Say what went wrong under a load; empty when nothing did."""
    ran, lost = recorded(load, SEARCH_S, folder)
    if lost.total:
        return f"the recorder loses {lost.total} of {sum(ran.sent.values())} messages"
    if ran.held < HELD:
        return f"the publishing process keeps {100 * ran.held:.0f} % of its rate, nothing is lost"
    return ""


def search(make: Callable[[int], Load], start: int, folder: Path) -> Break:
    """Doubles a load until something gives in, then halves the distance.

    Args:
        make: a load of a size.
        start: the size that is tried first.
        folder: for the bags.
    """
    good, size = 0, start
    while not (why := gave_in(make(size), folder)):
        good, size = size, 2 * size
    bad = size
    for _ in range(SEARCH_STEPS):
        size = (good + bad) // 2
        if size in (good, bad):
            break
        if found := gave_in(make(size), folder):
            bad, why = size, found
        else:
            good = size
    return Break(make(good) if good else None, make(bad), why)


def report_break(name: str, found: Break, rate: Callable[[Load], float], unit: str) -> None:
    report(
        f"recording: {name} recorded whole",
        rate(found.good) if found.good else 0.0,
        None,
        unit,
        f"{found.good or 'nothing'}; under {found.bad} {found.why} (runs of {SEARCH_S:g} s)",
        lower=False,
    )


@click.command()
@click.option("--seconds", default=SECONDS, show_default=True, help="Duration of each load.")
@click.option(
    "--folder",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=Path(tempfile.gettempdir()),
    show_default=True,
    help="For the bags, which are removed again.",
)
@click.option("--search/--no-search", "searching", default=LONG, help="Look for where it breaks.")
def main(seconds: float, folder: Path, searching: bool) -> None:
    """Measure recording end to end."""
    for load in LOADS:
        bound = discarded(load, seconds)
        ours, lost = recorded(load, seconds, folder)
        thrown = sum(bound.told.values())
        report(
            f"recording: CPU, {load}",
            100.0 * ours.cpu_share,
            100.0 * bound.cpu_share,
            "% of a core",
            f"{load.bytes_per_s / 1e6:.0f} MB/s, {seconds:g} s each; rate kept to "
            f"{100 * ours.held:.1f} % and {100 * bound.held:.1f} %; "
            f"{sum(bound.sent.values()) - thrown} of the discarded messages did not come",
            lower=True,
            ratio_limit=RATIO_LIMIT,
        )
        report(
            f"recording: lost, {load}",
            float(max(lost.total, ours.told["lost"])),
            None,
            "messages",
            f"{sum(ours.sent.values())} sent; {lost.by_count} missing by count, {lost.by_gaps} by "
            f"gaps, {lost.wrong} altered; the recorder reports {ours.told['lost']}",
            lower=True,
            limit=0.0,
        )
    if searching:
        found = search(lambda hz: Load(objects=100, object_hz=float(hz)), 200, folder)
        report_break("messages", found, lambda load: load.messages_per_s, "messages/s")
        found = search(lambda cameras: Load(raws=cameras, objects=20), 4, folder)
        report_break("frames", found, lambda load: load.bytes_per_s / 1e6, "MB/s")


if __name__ == "__main__":
    try:
        main()
    except HostError as error:
        sys.exit(f"recording: {error}")
