"""The reduced model of a skin: whether it is possible, its construction, and the end of its validity."""
