"""The operators' page under twenty objects at 100 Hz: what its process takes of a core.

The objects come in one array, as one process of many sends them, and in turn each on a topic of its
own. A viewer that reads everything is connected; the lower bound is the same process without one,
which does nothing but take the messages.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import aiohttp

sys.path.insert(0, str(Path(__file__).parents[2]))

from measure import LONG, report

from ssp_core.host.domains import free_domain
from tests.system.test_page import OBJECTS, TOKEN, Stage

MEASURED_S = 10.0
SETTLE_S = 2.0
MOST = 4.0  # times the process that only takes the messages


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share_over(pid: int, wait_s: float) -> float:
    """Share of a core over some time."""
    before, began = cpu_s(pid), time.monotonic()
    time.sleep(wait_s)
    return (cpu_s(pid) - before) / (time.monotonic() - began)


async def watch(pid: int, port: int) -> tuple[float, int]:
    """Share of a core while one viewer reads; and snapshots it got."""
    async with (
        aiohttp.ClientSession() as client,
        client.ws_connect(f"http://127.0.0.1:{port}/api/live") as stream,
    ):
        await stream.send_json({"type": "hello", "token": TOKEN})
        count = 0
        measuring = asyncio.create_task(asyncio.to_thread(share_over, pid, MEASURED_S))
        while not measuring.done():
            message = await stream.receive_json(timeout=10.0)
            count += message["type"] == "snapshot"
            if message["type"] == "mark":
                await stream.send_str(f'{{"echo":{message["n"]}}}')
        return await measuring, count


def measure(way: str) -> None:
    """One way in which the states come."""
    with tempfile.TemporaryDirectory() as folder, free_domain() as domain_id:
        stage = Stage(Path(folder), domain_id)
        try:
            stage.manager()
            stage.objects(moving=True, single=way == "single")
            process, port = stage.page()
            time.sleep(SETTLE_S)
            bound = share_over(process.pid, MEASURED_S)
            ours, snapshots = asyncio.run(watch(process.pid, port))
        finally:
            stage.close()
    report(
        f"page: {OBJECTS} objects, {way}",
        100.0 * ours,
        100.0 * bound,
        "% of a core",
        json.dumps({"snapshots_per_s": round(snapshots / MEASURED_S, 1)}),
        lower=True,
        ratio_limit=MOST,
    )


def main() -> None:
    for way in ("array", "single") if LONG else ("array",):
        measure(way)


if __name__ == "__main__":
    main()
