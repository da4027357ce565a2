"""Shared parts of several methods: seeds, densification, labelling, outliers, noise, and certificates."""
