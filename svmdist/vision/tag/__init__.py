"""AprilTags: found by their corners, and their pose refined on all their pixels."""
