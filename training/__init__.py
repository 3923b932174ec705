"""A small network for segmentation, trained on randomised pictures rendered here: scenes, network, training."""
