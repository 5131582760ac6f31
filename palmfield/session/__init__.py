"""What a user does with a scene: load and step it, run it, plan it, play it on a board."""
