"""Result objects to tables, CSV, JSON and plots."""
