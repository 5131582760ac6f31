"""How loud a scene is to people, and what of that may be played."""
