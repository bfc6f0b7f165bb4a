"""What outlived a session: node processes and shared memory of dead ones."""

from __future__ import annotations

from pathlib import Path

from ssp_core.processes import others_share_memory, remove_stale_shared_memory


def left_behind(folder: Path) -> list[str]:
    """Sentences about processes that still write into a run's logs and memory nobody owns.

    The memory is removed, so that the next run is judged by its own. While other participants of
    DDS run on this host nobody can tell whose it was, and it counts for nothing.

    Args:
        folder: of a run that has ended.
    """
    logs = (folder / "logs").resolve()
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            output = (entry / "fd" / "1").resolve()
            name = (entry / "comm").read_text().strip()
        except OSError:
            continue  # it ended meanwhile, or is another user's
        if output.parent == logs:
            found.append(f"process {entry.name} ({name}) still runs and writes {output.name}")
    alone = not others_share_memory()
    stale = remove_stale_shared_memory()
    if stale and alone:
        found.append(f"{stale} segments of shared memory were left in /dev/shm")
    return found
