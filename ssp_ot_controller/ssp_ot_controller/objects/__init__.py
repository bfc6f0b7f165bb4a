"""Object targets: the pool of one process, references, local safety, states of each object."""
