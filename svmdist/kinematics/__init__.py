"""Denavit–Hartenberg kinematics: chains of joints, forward and inverse."""
