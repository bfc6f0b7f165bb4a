"""One session over DDS: its processes, how it is followed, and the word that starts it."""
