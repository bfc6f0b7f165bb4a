"""Settings and actors that a killed client left in a server, kept on this machine for the next.

A client that takes a server over writes a file and holds its lock, and removes it when it has
given everything back. A file whose lock is free was left by a client that is gone.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.carla.address import CarlaAddress
from ssp_core.carla.lights import Lights


@dataclass(frozen=True, slots=True)
class Leftovers:
    """Settings and actors that are to be given back.

    Args:
        settings: of carla.WorldSettings, by name.
        weather: of carla.WeatherParameters, by name.
        actors: that were spawned.
        lights: the traffic lights; None: they were left alone.
    """

    settings: Mapping[str, Any]
    weather: Mapping[str, float]
    actors: frozenset[int]
    lights: Lights | None = None


class LeftFile:
    """The file of one server, which is this client's until ``remove``.

    A folder that can't be written is no reason not to run: then nothing is kept.
    """

    def __init__(self, address: CarlaAddress) -> None:
        self._file = _place(address)
        self._handle: int | None = None

    def write(
        self,
        settings: Mapping[str, Any],
        weather: Mapping[str, float],
        actors: Iterable[int],
        lights: Lights | None = None,
    ) -> None:
        """Keep what is to be given back, in place of what was kept before."""
        leftovers = {
            "settings": dict(settings),
            "weather": dict(weather),
            "actors": sorted(actors),
            "lights": None if lights is None else lights.values,
        }
        data = json.dumps(leftovers).encode() + b"\n"
        with suppress(OSError):
            if self._handle is None:
                self._file.parent.mkdir(parents=True, exist_ok=True)
                handle = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._handle = handle
            # One write over the old text: whoever is killed before it leaves the old one.
            os.pwrite(self._handle, data, 0)
            os.ftruncate(self._handle, len(data))

    def remove(self) -> None:
        """Keep nothing any more."""
        if self._handle is None:
            return
        with suppress(OSError):
            self._file.unlink()
        os.close(self._handle)
        self._handle = None


def read_left(address: CarlaAddress) -> Leftovers | None:
    """Read what a client of this machine that is gone left in a server; None: nothing is known."""
    try:
        handle = os.open(_place(address), os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        leftovers = json.loads(os.read(handle, 1 << 20))
        lights = None if leftovers["lights"] is None else Lights.of_values(leftovers["lights"])
        actors = frozenset(map(int, leftovers["actors"]))
        return Leftovers(leftovers["settings"], leftovers["weather"], actors, lights)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    finally:
        os.close(handle)


def forget_left(address: CarlaAddress) -> None:
    """Remove the file of a client that is gone."""
    with suppress(OSError):
        _place(address).unlink()


def _place(address: CarlaAddress) -> Path:
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    name = hashlib.sha256(str(address).encode()).hexdigest()[:16]
    return Path(base) / "ssp" / "carla" / f"{name}.json"
