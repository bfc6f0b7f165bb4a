"""How objects move: states, references, speed profiles, manoeuvres and encounters."""
