"""ROS 1 bags and rosbag2 folders to raw messages."""

METADATA_FILE = "metadata.yaml"
"""What makes a folder a rosbag2 recording."""
