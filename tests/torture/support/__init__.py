"""Tools of the torture tests."""
