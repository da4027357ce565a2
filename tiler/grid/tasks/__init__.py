"""Tasks of the stage grid, and the entries of run.json that follow from their records."""
