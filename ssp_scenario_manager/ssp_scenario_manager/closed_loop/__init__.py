"""Driven sessions: starts and twins, outcomes, and campaigns (METHOD 8)."""
