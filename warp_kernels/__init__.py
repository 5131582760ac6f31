"""Warp kernels and device functions. Imports warp but not palmfield."""
