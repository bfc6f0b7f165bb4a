"""Campaigns of driven runs for people: statistics over events, pairs of drivers, and the page."""
