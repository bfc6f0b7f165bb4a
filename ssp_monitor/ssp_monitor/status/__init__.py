"""A session as onlookers hear it: newest values, what blocks arming, health and drawing."""
