"""Image processing on plain arrays: masks, regions, edges, marks, stereo, degradations."""
