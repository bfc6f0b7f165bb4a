"""Bodies of objects: their dynamics, the datagrams of hardware, and simulated ones."""
