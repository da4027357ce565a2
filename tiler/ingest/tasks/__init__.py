"""Tasks of the stage ingest, and what is known of them."""
