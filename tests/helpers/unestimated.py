"""Runs without the estimate of their errors, which takes seconds: for tests that look at something else."""

from unittest import mock

UNESTIMATED = mock.patch("palmfield.estimate.estimated_run.estimated_budget", lambda *_: "left out by a test")
"""Decorates a test, or is entered around its run."""
