"""What the error estimate of a finished run compares: meshes, cut faces, materials, courses of time."""
