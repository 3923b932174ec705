"""svmdist."""
