"""The exact distance between the surfaces of instrument and organ, and of two instruments."""
