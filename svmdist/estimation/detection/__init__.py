"""Detections: what one image shows of tool and tissue, each found by one piece of code for all methods."""
