"""Estimates against their references: the truth, the pairs, and the figures of both."""
