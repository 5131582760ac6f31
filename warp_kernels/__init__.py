"""Warp kernels and device functions. This package imports warp but not palmfield."""
