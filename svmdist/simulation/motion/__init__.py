"""What the instrument does: scenarios, their smooth paths, and joint trajectories that follow them."""
