"""How a map turns an image into a signature."""
