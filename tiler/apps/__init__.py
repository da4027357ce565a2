"""Commands other than `tiler run` that use the pipeline or read its results."""
