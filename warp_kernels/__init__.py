"""Warp kernels and device functions. Imports warp and nothing of palmfield."""
