"""Tasks of the stage filter."""
