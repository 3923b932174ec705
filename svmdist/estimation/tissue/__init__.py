"""The tissue: where it lies, its surface by both views, its shape, and how it moves."""
