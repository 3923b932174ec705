"""A small network for segmentation, trained on randomised pictures that are drawn here: scenes, network, training."""
