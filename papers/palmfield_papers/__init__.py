"""What four papers claim, computed again and held against tolerances that were fixed beforehand (docs/gallery)."""
