"""The software-in-the-loop world: bodies, traffic, the VUT's driver, disturbances, and lockstep."""
