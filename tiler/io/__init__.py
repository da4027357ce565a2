"""Files: locations, checks before files are overwritten, and formats of clouds and vectors."""
