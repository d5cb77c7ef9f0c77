"""From a scan to an image (paper, sec. 2.1): range images and height images."""
