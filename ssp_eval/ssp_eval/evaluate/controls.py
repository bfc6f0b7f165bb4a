"""The models that check the harness rather than drive; they stay out of means and ranks."""

from __future__ import annotations

from typing import Any

# In the options of a bridge these words stand for what only the cell knows.
LABELS_FILE = "{labels_file}"
CLIP_START_NS = "{clip_start_ns}"
# Options that nobody should have to type, by control: the privileged one needs both.
CONTROLS: dict[str, dict[str, Any]] = {
    "perfect": {"labels_file": LABELS_FILE, "clip_start_ns": CLIP_START_NS},
    "silent": {},
    "recorded": {},
}
# Whatever such a bridge is called, it is no model; a recording may be of one.
NEVER_MODELS = frozenset({"perfect", "silent"})

# What --controls adds: answerers, and conditions under which each model is asked once more.
ANSWERERS = ("constant_velocity", "copy_history", "perfect", "silent")
BLACK = "black"
SHUFFLED = "shuffled"
CONDITIONS = (BLACK, SHUFFLED)
# Of the order into which frames are put; one for all campaigns, so that they can be compared.
CONDITION_SEED = 1


def is_control_name(model: str) -> bool:
    """Whether a name alone says that it is no model but a check of the harness."""
    return model in CONTROLS or model.endswith(tuple(f"+{name}" for name in CONDITIONS))
