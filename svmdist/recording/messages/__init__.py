"""Bytes of single messages to samples and back: Foxglove, ROS, images, video. No file formats."""
