"""A run: its record, its executors, and the work of a worker."""
