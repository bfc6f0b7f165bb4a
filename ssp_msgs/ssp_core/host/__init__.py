"""The machine that a session runs on: its ROS domains, shared memory, processes and variables.

Here stands all that a session takes of its host, and gives back: a domain of its own, held by a
lock; room in /dev/shm; node processes, which end in any case; environment variables, checked before
they reach a node; the terminal, which may end a program; a cluster that others may share.
"""
