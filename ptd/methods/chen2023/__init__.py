"""`chen2023`: seeds by a progressive morphological opening (Chen et al., 2023)."""
