"""Tasks of the stage grid, and the facts from their records."""
