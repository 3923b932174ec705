"""Instruments without colours from the user: evidence, outlines, masks."""
