"""Commands beside the pipeline, which use it or read its results."""
