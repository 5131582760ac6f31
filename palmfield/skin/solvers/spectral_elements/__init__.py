"""Explicit spectral-element solver of a skin layer: matrix-free, on the CPU or a GPU."""
