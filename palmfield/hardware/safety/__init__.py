"""Sound exposure of people in a scene, and limits for playing."""
