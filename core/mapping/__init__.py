"""From drives to a map (paper, sec. 2.2): build, merge, compare and calibrate TensorMaps."""
