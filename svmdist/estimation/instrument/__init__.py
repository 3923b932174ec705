"""The instrument in 3D: its model, what images show of its pose, its fits, and the filter over kinematic errors."""
