"""The paper's static virtual marker: its pattern, ORB features, patch geometry and homography."""
