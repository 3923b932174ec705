"""The paper's static virtual marker: its pattern, ORB features and homography."""
