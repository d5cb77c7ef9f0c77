"""The paper's encoding: each segment has bases of its own (paper, sec. 2.2 and 2.3)."""
