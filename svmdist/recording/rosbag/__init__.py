"""ROS 1 bags and rosbag2 folders to raw messages."""
