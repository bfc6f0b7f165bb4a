"""CARLA 0.9.16: the connection to a server, its facts, and the placement of actors."""
