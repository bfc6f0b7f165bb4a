"""Campaigns of driven runs: the plan, the sealed starts, a row per run."""
