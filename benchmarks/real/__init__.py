"""The sets of real images: a module for each, which makes its logs and scores them."""
