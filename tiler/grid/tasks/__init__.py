"""Tasks of the stage grid, and what is found from their records."""
