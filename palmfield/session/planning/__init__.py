"""What `palmfield.session.plan` is made of: its rows, what they cost, and how they read."""
