"""The Kalman filter over kinematic errors: measurements of links, their gate, the state and its updates."""
