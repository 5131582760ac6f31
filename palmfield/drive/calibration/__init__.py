"""Compute a calibration from a laboratory's readings: one file for each kind of measurement (docs/calibration.md)."""
