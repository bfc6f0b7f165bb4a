"""Observation files: found beside a recording, read, held against it, and sealed (METHOD 4.3)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_mapping
from ssp_core.files.writing import write_json
from ssp_eval.data.provenance import bag_folder
from ssp_eval.observations.model import Observation

SUFFIXES = (".json", ".yaml", ".yml")
STEM = "observation"
# A typed time is rounded.
_ROUNDING_S = 0.0005


@dataclass(frozen=True)
class Footage:
    """The recording that an observation is compared with.

    Args:
        bag_sha256: content hash of the recording.
        frames_s: clip times of all its frames, rising; those before the start are negative.
    """

    bag_sha256: str
    frames_s: tuple[float, ...]

    @property
    def period_s(self) -> float:
        """Median time between frames; 0 with fewer than two."""
        steps = sorted(b - a for a, b in zip(self.frames_s, self.frames_s[1:], strict=False))
        return steps[len(steps) // 2] if steps else 0.0

    def frame_at(self, t_s: float) -> int:
        """Index of the newest frame at or before a clip time, else of the first."""
        return max(0, bisect_right(self.frames_s, t_s + 1e-9) - 1)


def find_observations(bag: Path) -> list[Path]:
    """Return the observation files of a recording, by name.

    They lie in the bag's folder or, of a bag that is called ``bag``, in its run folder, as
    ``observation*.json`` or ``.yaml``; or beside it as ``<bag>.observation*.json`` or ``.yaml``.

    Args:
        bag: its folder, or an MCAP file.
    """
    folder = bag_folder(bag)
    places = [(folder.parent, f"{folder.name}.{STEM}")]
    if folder.is_dir():
        places.append((folder, STEM))
    if folder.name == "bag":
        places.append((folder.parent, STEM))
    return sorted(
        {
            path
            for place, start in places
            for path in place.glob(f"{start}*")
            if path.suffix in SUFFIXES and path.is_file()
        }
    )


def default_place(bag: Path, who: str) -> Path:
    """Return the path of a person's sealed observation: beside the recording, where it is found."""
    folder = bag_folder(bag)
    name = "".join(c if c.isalnum() else "_" for c in who.casefold()).strip("_") or "observer"
    start = STEM if folder.name == "bag" else f"{folder.name}.{STEM}"
    return folder.parent / f"{start}_{name}.json"


def load_observations(
    bag: Path, footage: Footage, extra_files: Sequence[Path] = ()
) -> tuple[tuple[Path, Observation], ...]:
    """Return the sealed observations of a recording, each with its file.

    Args:
        bag: folder or MCAP file of the recording.
        footage: frames of the recording that they must be of.
        extra_files: files besides those that lie with it.

    Raises:
        InputError: one of them isn't sealed, was changed since, is of another recording, or says
            what can't be of this one.
    """
    paths = {path.resolve(): path for path in (*find_observations(bag), *extra_files)}
    return tuple((path, load_observation(path, footage)) for path in paths.values())


def load_observation(path: Path, footage: Footage) -> Observation:
    """Read a sealed observation and hold it against its recording; see load_observations."""
    observation = read_observation(path)
    check_observation(observation, footage, path)
    return observation


def read_observation(path: Path) -> Observation:
    """Read a sealed observation, whatever recording it is of.

    Raises:
        InputError: it is none, isn't sealed, or was changed since.
    """
    observation = parse_model(Observation, read_mapping(path), path)
    if observation.seal is None:
        raise InputError(
            "is a draft: it isn't sealed",
            file=path,
            field="seal",
            remedy=f"`ssp audit observe BAG --seal {path.name}` checks and seals it",
        )
    check_seal(observation, path)
    return observation


def check_seal(observation: Observation, file: str | Path) -> None:
    """Raise InputError where a sealed observation isn't what was sealed."""
    if observation.seal != observation.content_sha256:
        raise InputError(
            f"was changed after {observation.who} sealed it: its content has the hash "
            f"{observation.content_sha256}",
            file=file,
            field="seal",
            value=observation.seal,
            remedy="take the sealed file again, or let the observer look again and seal that",
        )


def check_observation(observation: Observation, footage: Footage, file: Path) -> None:
    """Hold an observation against its recording.

    Raises:
        InputError: it is of another recording, contradicts itself, names a frame that isn't there
            or a time outside the recording.
    """
    if observation.bag_sha256 != footage.bag_sha256:
        raise InputError(
            f"is of another recording, or of an earlier state of this one, which has the hash "
            f"{footage.bag_sha256}",
            file=file,
            field="bag_sha256",
            value=observation.bag_sha256,
            remedy="name the bag that was looked at, or look at this one",
        )
    for path, problem in observation.contradictions():
        raise InputError(problem, file=file, field=path, remedy="correct it, then seal it again")
    last = len(footage.frames_s) - 1
    for path, frame_answers in observation.evidence_groups():
        for number, item in enumerate(frame_answers.frames):
            newest = item if isinstance(item, int) else item[1]
            if newest > last:
                raise InputError(
                    "is no frame of this recording",
                    file=file,
                    field=f"{path}.frames[{number}]",
                    value=newest,
                    remedy=f"its frames are 0 to {last}",
                )
    first_s, last_s = footage.frames_s[0], footage.frames_s[-1]
    phases = observation.phases
    times = {"start_s": phases.start_s, "end_s": phases.end_s}
    times |= {f"{name}.t_s": t_s for name, t_s in observation.phase_starts().items()}
    for name, t_s in times.items():
        if t_s is not None and not first_s - _ROUNDING_S <= t_s <= last_s + _ROUNDING_S:
            raise InputError(
                "lies outside the recording",
                file=file,
                field=f"phases.{name}",
                value=t_s,
                remedy=f"its frames run from {first_s:.3f} to {last_s:.3f} s",
            )


def sealed_observation(
    file: Path, footage: Footage, recording: str, now: str, who: str | None = None
) -> Observation:
    """Read a draft, check it, and seal it.

    Args:
        file: of a page, or filled in by hand. What it leaves open of hash, recording and time is
            put in.
        footage: frames of the recording that it is of.
        recording: name of the recording.
        now: ISO 8601 UTC.
        who: looked; None: the file says it.

    Raises:
        InputError: it isn't right; see check_observation.
    """
    value: dict[str, Any] = dict(read_mapping(file))
    if value.get("seal") is not None:
        read_observation(file)
        raise InputError(
            "is sealed already",
            file=file,
            field="seal",
            value=value["seal"],
            remedy="make a new one with `ssp audit observe`",
        )
    observer = value.get("who")
    if who is not None and observer is not None and observer != who:
        raise InputError(
            f"names another person than --who {who}",
            file=file,
            field="who",
            value=observer,
            remedy="leave --who out, or let that person seal it",
        )
    value["who"] = observer if who is None else who
    if value["who"] is None:
        raise InputError("names no person", file=file, field="who", remedy="give --who NAME")
    for key, own in (("bag_sha256", footage.bag_sha256), ("recording", recording), ("when", now)):
        if value.get(key) is None:
            value[key] = own
    draft = parse_model(Observation, value, file)
    check_observation(draft, footage, file)
    return draft.model_copy(update={"seal": draft.content_sha256})


def write_observation(path: Path, observation: Observation) -> None:
    """Write an observation as JSON."""
    write_json(path, observation.model_dump(mode="json", by_alias=True))
