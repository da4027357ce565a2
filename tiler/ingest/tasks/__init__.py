"""Tasks of the stage ingest, and their results."""
