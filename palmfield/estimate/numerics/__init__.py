"""Comparisons for the error estimate of a finished run: meshes, cut faces, materials, and motion over time."""
