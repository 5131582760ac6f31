"""The small model of a skin: whether there is one, its construction, and its end."""
