"""The statements of a bag beside its messages: ``metadata.yaml``, and QoS profiles as YAML."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_value, read_mapping

# A topic of a hundred publishers has 50,000.
MAX_TEXT = 64 << 10
# As rosbag2 writes it: by name, or before Jazzy by rmw's number.
_LATCHED = ("transient_local", 1)
_KEEP_ALL = ("keep_all", 2)
# A publisher doesn't tell others its history; what a graph says of it then is no depth.
_UNTOLD = ("unknown", 3, "system_default", 0)
# rmw's infinite duration, as rosbag2 writes it.
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


def offered_qos(depth: int, *, transient_local: bool = False) -> str:
    """Return the YAML of one reliable KEEP_LAST publisher, for BagWriter.add_topic.

    Args:
        depth: the publisher's history, messages.
        transient_local: the publisher keeps its last messages for those that join later.
    """
    profile = {
        "history": "keep_last",
        "depth": depth,
        "reliability": "reliable",
        "durability": "transient_local" if transient_local else "volatile",
        "deadline": dict(_INFINITE),
        "lifespan": dict(_INFINITE),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)


@lru_cache(maxsize=1024)
def parse_offered_qos(text: str) -> list[dict[str, Any]]:
    """Return the profiles in the YAML of a channel; an empty text has none.

    The result is shared by all callers with the same text, since thousands of topics have the
    same few profiles: it must not be changed.

    Raises:
        ValueError: the text is no YAML list of mappings.
    """
    if not text:
        return []
    if len(text) > MAX_TEXT:
        raise ValueError(f"offered_qos_profiles has {len(text)} characters, at most {MAX_TEXT}")
    try:
        profiles = parse_value(text, "offered_qos_profiles")
    except InputError as error:
        raise ValueError(str(error)) from error
    if not isinstance(profiles, list) or not all(isinstance(item, dict) for item in profiles):
        raise ValueError("offered_qos_profiles is no list of mappings")
    return profiles


def is_latched(offered_qos: str) -> bool:
    """Tell whether a publisher keeps its messages for those that join later.

    Args:
        offered_qos: YAML of a topic's publishers; what is no such YAML says nothing.
    """
    try:
        profiles = parse_offered_qos(offered_qos)
    except ValueError:
        return False
    return any(profile.get("durability") in _LATCHED for profile in profiles)


def usable_qos(offered_qos: str) -> str:
    """Return the same YAML, empty where it is none.

    Messages matter more than what was once offered.
    """
    try:
        parse_offered_qos(offered_qos)
    except ValueError:
        return ""
    return offered_qos


def stated_depth(offered_qos: str, most: int) -> int | None:
    """Count the messages that a topic's publishers offer together to a late subscriber.

    Args:
        offered_qos: YAML of a topic's publishers.
        most: no claim beyond this is believed; it is what KEEP_ALL has.

    Returns:
        None: at least one of them doesn't say how many, or there is none.

    Raises:
        ValueError: the text is no YAML list of mappings.
    """
    depth = 0
    for profile in parse_offered_qos(offered_qos):
        claimed, history = profile.get("depth"), profile.get("history")
        if history in _KEEP_ALL:
            depth += most
        elif isinstance(claimed, int) and claimed > 0 and history not in _UNTOLD:
            depth += claimed
        else:
            return None
    return min(depth, most) or None


VERSION = 9
FILE_NAME = "metadata.yaml"
ROOT_KEY = "rosbag2_bagfile_information"
ROS_DISTRO = "jazzy"
# Ten thousand topics take ten seconds to write as YAML and fifty to read; as JSON, which is YAML
# too, less than one. People read that of an ordinary bag.
MANY_TOPICS = 500


@dataclass(frozen=True, slots=True)
class TopicFacts:
    """One topic: name, full type name, offered QoS as YAML, RIHS01 hash, messages written."""

    name: str
    msgtype: str
    offered_qos: str
    type_hash: str
    count: int
    message_encoding: str = "cdr"


@dataclass(frozen=True, slots=True)
class FileFacts:
    """One file of a bag: its name, earliest and latest log time in ns, messages in it."""

    name: str
    start_ns: int
    end_ns: int
    count: int


@dataclass(frozen=True, slots=True)
class BagFacts:
    """The facts of metadata.yaml: the bag's files in order, and its topics over all files.

    Counts are of messages in files: a latched message that a later file repeats counts again, as
    rosbag2 counts it.
    """

    files: tuple[FileFacts, ...]
    topics: tuple[TopicFacts, ...]

    @property
    def count(self) -> int:
        return sum(file.count for file in self.files)

    @property
    def start_ns(self) -> int:
        return min((file.start_ns for file in self.files if file.count), default=0)

    @property
    def end_ns(self) -> int:
        return max((file.end_ns for file in self.files if file.count), default=0)


def bag_information(facts: BagFacts) -> dict[str, Any]:
    """Return the mapping under ``rosbag2_bagfile_information``, with every key of version 9."""
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(facts.start_ns, facts.end_ns),
        "message_count": facts.count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.msgtype,
                    "serialization_format": topic.message_encoding,
                    "offered_qos_profiles": parse_offered_qos(topic.offered_qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in facts.topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in facts.files],
        "files": [
            {
                "path": file.name,
                **_span(file.start_ns, file.end_ns),
                "message_count": file.count,
            }
            for file in facts.files
        ],
        "custom_data": None,
        "ros_distro": ROS_DISTRO,
    }


def _span(start_ns: int, end_ns: int) -> dict[str, dict[str, int]]:
    return {
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
    }


class _Dumper(yaml.CSafeDumper):
    """Writes a value that stands in several places out each time, as rosbag2 does."""

    def ignore_aliases(self, _data: object) -> bool:
        return True


def serialized_metadata(facts: BagFacts) -> str:
    """Return the text of the metadata record ``rosbag2`` in an MCAP file."""
    return _text(bag_information(facts), facts)


def metadata_yaml(facts: BagFacts) -> str:
    """Return the text of metadata.yaml."""
    return _text({ROOT_KEY: bag_information(facts)}, facts)


def _text(value: dict[str, Any], facts: BagFacts) -> str:
    if len(facts.topics) > MANY_TOPICS:
        return json.dumps(value, ensure_ascii=False) + "\n"
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True))


@dataclass(frozen=True, slots=True)
class BagDirectory:
    """The part of a metadata.yaml that a reader needs.

    It holds the files in order, and the counts that it claims.
    """

    files: tuple[Path, ...]
    message_count: int
    topic_counts: dict[str, int]


def read_metadata(folder: Path) -> BagDirectory:
    """Read the metadata.yaml of a bag directory of any version that names MCAP files.

    Raises:
        InputError: it isn't there, can't be parsed, or is of a bag that is not plain MCAP.
    """
    path = folder / FILE_NAME
    if not path.is_file():
        remedy = "name a folder with metadata.yaml, or a .mcap file"
        if any(folder.glob("*.mcap")):
            remedy = "`ssp bag recover` makes a readable bag of an interrupted recording"
        inner = min(folder.glob(f"*/{FILE_NAME}"), default=None)
        if inner is not None:  # as in a session's folder, where the bag is one of several things
            remedy = f"there is one in it: {inner.parent}"
        raise InputError(f"has no {FILE_NAME}, so it is no closed bag", file=folder, remedy=remedy)
    information = read_mapping(path).get(ROOT_KEY)
    if not isinstance(information, dict):
        raise InputError(
            "is missing or no mapping",
            file=path,
            field=ROOT_KEY,
            remedy="`ssp bag recover` makes a readable bag of its files",
        )
    storage = information.get("storage_identifier")
    if storage != "mcap":
        raise InputError(
            "is a storage that is not read here",
            file=path,
            field=f"{ROOT_KEY}.storage_identifier",
            value=storage,
            remedy="convert the bag to mcap with `ros2 bag convert`",
        )
    if information.get("compression_mode") not in (None, "", "none", "NONE", "storage"):
        raise InputError(
            "compressed bags are not read here",
            file=path,
            field=f"{ROOT_KEY}.compression_mode",
            value=information["compression_mode"],
            remedy="convert the bag to plain mcap with `ros2 bag convert`",
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError(
            "must list the bag's files",
            file=path,
            field=f"{ROOT_KEY}.relative_file_paths",
            remedy="`ssp bag recover` makes a readable bag of its files",
        )
    # Only the name counts: old bags wrote paths, and a bag reads no file outside its directory.
    files = tuple(folder / PurePosixPath(name).name for name in names)
    for file, count in Counter(files).items():
        _check_file(file, path)
        if count > 1:
            raise InputError(
                f"names {file.name} twice",
                file=path,
                remedy="`ssp bag recover` makes a readable bag of its files",
            )
    return BagDirectory(files, *_counts(information, path))


def unlisted_files(folder: Path, suffix: str = ".mcap") -> list[str]:
    """List the files of a bag's kind in its folder that metadata.yaml doesn't name.

    Raises:
        InputError: metadata.yaml can't be read.
    """
    information = read_mapping(folder / FILE_NAME).get(ROOT_KEY)
    paths = information.get("relative_file_paths") if isinstance(information, dict) else None
    file_names = {PurePosixPath(str(name)).name for name in paths or ()}
    return sorted(file.name for file in folder.glob(f"*{suffix}") if file.name not in file_names)


def _check_file(file: Path, path: Path) -> None:
    """Raise InputError unless a file that metadata.yaml names is one of the bag.

    It may be a link to elsewhere: large files are kept on other disks, and an evidence package
    lays its files out by links. What is behind it must be an MCAP file like any other.
    """
    try:
        there = file.is_file() and file.name not in ("", "..") and file.parent == path.parent
    except (OSError, ValueError) as error:  # too long a name, one with a NUL, a ring of links
        raise InputError(
            f"names {file.name!r}, which is no file: {error}",
            file=path,
            remedy="put the file back; `ssp bag recover` makes a readable bag of the others",
        ) from error
    if not there:
        raise InputError(
            f"names {file.name}, which is not there",
            file=path,
            remedy="put the file back; `ssp bag recover` makes a readable bag of the others",
        )


def _counts(information: dict[str, Any], path: Path) -> tuple[int, dict[str, int]]:
    try:
        topics = {
            str(item["topic_metadata"]["name"]): int(item["message_count"])
            for item in information["topics_with_message_count"]
        }
        return int(information["message_count"]), topics
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"message counts are missing or malformed: {error}",
            file=path,
            field=ROOT_KEY,
            remedy="`ssp bag recover` makes a readable bag of its files",
        ) from error
