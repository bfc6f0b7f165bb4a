"""The safety of a session: codes of its events, limits, the geofence and stopping distances."""
