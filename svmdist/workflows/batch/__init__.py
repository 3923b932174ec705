"""Many logs: one task a log, in this process, in others, or on a cluster; each result kept as soon as it is there."""
