"""The tissue in 3D: where one image puts it, and what is remembered of it."""
