"""Backends: models behind one call, over HTTP, as a Python function, or in this process."""
