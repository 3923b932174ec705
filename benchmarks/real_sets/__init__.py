"""Public sets of real images: how each becomes a log, and what its estimates are held against."""
