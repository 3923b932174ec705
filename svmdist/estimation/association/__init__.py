"""Which instrument is which, in an image and over time."""
