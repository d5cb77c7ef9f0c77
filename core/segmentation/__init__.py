"""Where a drive is cut into segments: fixed, as in the paper, or unequal, its future work."""
