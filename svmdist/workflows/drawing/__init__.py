"""Drawings of frames: what a method found in an image and what it measured, as data."""
