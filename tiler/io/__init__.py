"""Files: their places, what a run may overwrite, and the formats of clouds and vectors."""
