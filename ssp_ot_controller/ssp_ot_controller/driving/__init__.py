"""Driving the VUT by the plans of a driver: METHOD 8.3 and 8.4, and the baselines of 8.10."""
