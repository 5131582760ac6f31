"""Which small model serves a skin: whether there is one, how it is made, and where it ends."""
