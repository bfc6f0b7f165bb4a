"""CARLA 0.9.16: what a server says, what is put where, and the connection to it."""
