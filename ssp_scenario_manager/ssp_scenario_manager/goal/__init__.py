"""The action ``run_scenario``: a whole run as one goal."""
