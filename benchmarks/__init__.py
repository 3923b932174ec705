"""Reproduces the figures that the documentation shows."""
