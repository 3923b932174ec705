"""Instruments without a colour: what is straight-edged, comes in from the picture's border, and is not like tissue."""
