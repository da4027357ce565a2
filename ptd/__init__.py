"""Progressive TIN densification: arrays in, arrays out."""
