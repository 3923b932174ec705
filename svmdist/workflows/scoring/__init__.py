"""Scoring: estimates, ours or given, held against references, and their figures."""
