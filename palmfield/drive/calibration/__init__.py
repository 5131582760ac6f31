"""From a laboratory's readings to a calibration: one file for each kind of measurement (docs/calibration.md)."""
