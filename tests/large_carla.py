"""Ten thousand pictures of the CARLA counterpart: is each one the picture of its tick?

Not a test, because it takes minutes: ``PYTHONPATH=. .venv/bin/python tests/large_carla.py``.
Of each hundred pictures one is lost, one comes one to three pictures late, behind others. Prints
how many came, how many of them hold another frame or pose than their tick's, and the rate.
"""

from __future__ import annotations

import json
import sys
import time

from tests.support.carla.commands import client
from tests.support.carla.counterpart import Behaviour, Counterpart

PICTURES = 10_000


def main() -> int:
    late = {k: 1 + (k // 100) % 3 for k in range(150, PICTURES, 100)}
    lost = frozenset(range(120, PICTURES, 100))
    with Counterpart(Behaviour(late=late, lost=lost), seed=9) as server:
        began_s = time.monotonic()
        said = client("-m", "tests.support.carla.driver", server.address, str(PICTURES))
        took_s = time.monotonic() - began_s
    told = json.loads(said.splitlines()[-1])
    print(
        f"{PICTURES} ticks, {len(lost)} pictures lost, {len(late)} late: {told['came']} came, "
        f"{len(told['wrong'])} wrong, {PICTURES / took_s:.0f} ticks/s"
    )
    return int(bool(told["wrong"]) or told["came"] < PICTURES - len(lost) - len(late))


if __name__ == "__main__":
    sys.exit(main())
