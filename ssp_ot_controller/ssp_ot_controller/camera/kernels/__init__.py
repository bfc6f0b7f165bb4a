"""Compiled kernels that turn triangles, road and sky into pixels, and their palettes."""
