"""Compute the claims of four papers, and compare them within tolerances fixed beforehand (docs/gallery)."""
