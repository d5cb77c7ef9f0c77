"""Loop closures: checks of proposed ones."""
