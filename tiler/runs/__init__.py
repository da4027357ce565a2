"""A run: its state, record, executors, kernels, stages and repair."""
