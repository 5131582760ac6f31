"""Compute sound exposure of people in a scene, and check it against limits."""
