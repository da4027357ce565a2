"""Commands that are not the pipeline itself: each uses it, or reads what it wrote."""
