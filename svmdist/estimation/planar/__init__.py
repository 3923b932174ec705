"""The paper's plane: its equations, the mapping fitted to a scene, and the marker's outline."""
