"""World frames: whether the drives of a map agree on theirs."""
