"""Benchmarks that users can run: `palmfield bench`."""
