"""The software-in-the-loop world: SUMO, lockstep, disturbances."""
