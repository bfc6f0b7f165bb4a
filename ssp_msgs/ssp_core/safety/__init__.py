"""What keeps a session safe: codes of its events, limits, the geofence and stopping distances."""
