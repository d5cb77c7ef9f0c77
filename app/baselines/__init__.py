"""Other methods of place recognition that the comparison can run."""
