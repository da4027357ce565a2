"""`dong2018`: two stages, the second with thresholds from the noise of the points (Dong et al., 2018)."""
