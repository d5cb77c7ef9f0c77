"""Other methods of place recognition, implemented from their papers to compare with."""
