"""The motion of objects: states, references, speed profiles, manoeuvres and encounters."""
