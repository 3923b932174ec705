"""Image processing on plain arrays: segmentation, regions, marker, features, homography, blur."""
