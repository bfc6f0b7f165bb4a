"""What a bag carries beside its messages: the run as it is executed, and its compiled task."""

from __future__ import annotations

from pathlib import Path

from ssp_core.errors import InputError

RUN_NAME = "run.yaml"
TASK_FOLDER = "task"
# Of one file and of all together; maps are the large ones.
MOST_BYTES = 64 << 20

_MEDIA = {
    ".json": "application/json",
    ".jsonl": "application/jsonl",
    ".yaml": "application/yaml",
    ".yml": "application/yaml",
    ".xml": "application/xml",
    ".xodr": "application/xml",
}

Attachment = tuple[str, str, bytes]


def run_attachments(run_file: Path) -> list[Attachment]:
    """The run file, and every file of the folder ``task`` beside it, each under its own name.

    Args:
        run_file: that the session starts with.

    Returns:
        (name, media type, data); the run first, then the task's files by name.

    Raises:
        InputError: a file can't be read, has the run's name, or is too large.
    """
    found = [(RUN_NAME, _MEDIA[".yaml"], _read(run_file, MOST_BYTES))]
    folder = run_file.parent / TASK_FOLDER
    left = MOST_BYTES - len(found[0][2])
    files = sorted(path for path in folder.iterdir() if path.is_file()) if folder.is_dir() else []
    for path in files:
        if path.name == RUN_NAME:
            raise InputError(
                "has the name of the run itself", file=path, remedy="take it out of the task"
            )
        data = _read(path, left)
        left -= len(data)
        found.append((path.name, _MEDIA.get(path.suffix, "application/octet-stream"), data))
    return found


def _read(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=path) from error
    if len(data) > most:
        raise InputError(
            f"is too large: run and task together may have {MOST_BYTES >> 20} MiB in a bag",
            file=path,
            remedy="compile for a smaller map",
        )
    return data
