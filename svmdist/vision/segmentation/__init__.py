"""From an image to a mask for each part of the scene: by colour, or by a network."""
