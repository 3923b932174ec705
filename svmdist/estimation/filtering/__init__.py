"""The filter over kinematic errors: state, observations, updates, and what a frame gives it."""
