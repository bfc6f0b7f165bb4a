"""The backends that come with the project: baselines, controls and recorded answers."""
