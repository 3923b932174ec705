"""Solid geometry on plain arrays: capsules, surfaces, and the shortest separation between them."""
