"""Which region of the image is which instrument, over time."""
