"""Whether a proposed loop closure is true (paper, sec. 4)."""
