"""World frames: checks that the drives of a map share one."""
