"""Detections in images, each with its covariance, shared by all methods."""
