"""The estimators, each one page of named steps, and the paper's equations they use."""
