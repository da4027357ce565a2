"""What several methods share: seeds, densification, labelling, outliers, noise, and what a window is certain of."""
