"""The pose of the shaft, and of the tool at its end, from what one image shows of them."""
