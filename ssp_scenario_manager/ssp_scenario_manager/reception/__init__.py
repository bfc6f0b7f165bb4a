"""Subscriptions of the scenario_manager that don't belong to a single object target."""
