"""The instrument in 3D: what an image tells of its pose, and its model."""
