"""The hardware of a live session, played: the VUT with its GNSS/INS, its camera, and OT bodies."""
