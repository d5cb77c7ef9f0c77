"""From an image to a signature (paper, sec. 2.2): the paper's encoding, and a harmonic one."""
