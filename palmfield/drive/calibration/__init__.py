"""Compute a calibration from readings of a laboratory: one file for each kind of measurement (docs/calibration.md)."""
