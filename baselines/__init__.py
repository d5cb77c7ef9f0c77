"""Other methods of place recognition, made from their papers, for `tensormap compare`."""
