"""The reasons for which a run would be refused by a CARLA server."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_core.carla.address import CarlaAddress, parse_address
from ssp_core.errors import InputError
from ssp_core.files.reading import read_text
from ssp_core.hashing import sha256_bytes

# The largest towns have some 100 MB.
_MOST_MAP_BYTES = 256 << 20

# Prefixes of what somebody put into a world; traffic lights, signs and the spectator are its own.
_PUT_THERE = ("vehicle.", "walker.", "sensor.", "controller.", "static.prop.")


@dataclass(frozen=True, slots=True)
class ServerFacts:
    """A server's word on itself before anything is changed.

    Args:
        client_version: of the installed client.
        map_name: as the server names it, such as ``Carla/Maps/Town01``.
        map_sha256: of its OpenDRIVE, by ``opendrive_sha256``.
        synchronous: it waits for the tick of a client.
        ticking: while it is synchronous, another client ticks it.
        actors: type ids of all actors.
    """

    version: str
    client_version: str
    map_name: str = ""
    map_sha256: str = ""
    synchronous: bool = False
    ticking: bool = False
    actors: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Refusal:
    """A reason not to run on a server, and what to do about it."""

    text: str
    remedy: str


@dataclass(frozen=True, slots=True)
class ServerOfRun:
    """A server that draws or moves a run.

    Args:
        map_file: the OpenDRIVE file that the run was compiled for; the server's map must be the
            same.
    """

    address: CarlaAddress
    map_file: Path

    @classmethod
    def of_parameters(cls, carla: str, map_file: str, option: str) -> ServerOfRun:
        """Read the parameters of a node.

        Args:
            carla: HOST:PORT.
            map_file: path.
            option: of `ssp run`, from which they come.

        Raises:
            InputError: one of them is empty or wrong.
        """
        for name, value in (("carla", carla), ("map_file", map_file)):
            if not value:
                raise InputError(
                    "isn't given, and the run asks a CARLA server",
                    field=name,
                    remedy=f"start the run with `ssp run {option} carla://HOST:PORT`",
                )
        return cls(parse_address(carla, "carla"), Path(map_file))

    @property
    def parameters(self) -> dict[str, object]:
        """Return the parameters of a node."""
        return {"carla": str(self.address), "map_file": str(self.map_file)}

    @property
    def map_sha256(self) -> str:
        """Return the hash of the map; raise InputError where the file can't be read."""
        return opendrive_sha256(read_map(self.map_file))


def opendrive_sha256(text: str) -> str:
    """Return the hash of a map's text, whatever its byte order mark and line ends are."""
    plain = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    return sha256_bytes(plain.encode())


def read_map(path: str | Path) -> str:
    """Return the text of an OpenDRIVE file; raise InputError where it can't be read."""
    return read_text(path, _MOST_MAP_BYTES)


def version_refusal(version: str, client_version: str) -> Refusal | None:
    """Refuse a server of another version, whose messages the client would misread."""
    if version == client_version:
        return None
    return Refusal(
        f"the server is CARLA {version}, the client {client_version}",
        f"start a server of {client_version}: the messages differ from version to version",
    )


def foreign_actors(actors: Sequence[str]) -> list[str]:
    """List the type ids of actors that somebody put into the world, sorted."""
    return sorted(one for one in actors if one.startswith(_PUT_THERE))


def refusals(facts: ServerFacts, wanted_map_sha256: str | None) -> list[Refusal]:
    """List the reasons not to run, the gravest first.

    Args:
        facts: of the server, as it stands.
        wanted_map_sha256: of the OpenDRIVE that a run is for, by ``opendrive_sha256``; None: any.
    """
    version = version_refusal(facts.version, facts.client_version)
    if version is not None:
        return [version]
    reasons = []
    if facts.synchronous:
        reasons.append(_synchronous(facts.ticking))
    foreign = foreign_actors(facts.actors)
    if foreign:
        counted = Counter(foreign)
        counts_text = ", ".join(f"{count} × {name}" for name, count in sorted(counted.items())[:5])
        more = f" and {len(counted) - 5} more kinds" if len(counted) > 5 else ""
        reasons.append(
            Refusal(
                f"{len(foreign)} actors of somebody else are in the world: {counts_text}{more}",
                "end the program that put them there, or load the world anew",
            )
        )
    if wanted_map_sha256 is not None and wanted_map_sha256 != facts.map_sha256:
        reasons.append(
            Refusal(
                f"the server's map {facts.map_name} has OpenDRIVE {facts.map_sha256}, "
                f"the run's has {wanted_map_sha256}",
                "load the map that the run was compiled for, or compile it for this one",
            )
        )
    return reasons


def _synchronous(ticking: bool) -> Refusal:
    if ticking:
        return Refusal("another client ticks the server", "end it, or take another server")
    return Refusal(
        "the server is synchronous and no client ticks it: a client died",
        "restart the server",
    )
