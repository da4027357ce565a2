"""`dong2017`: coloured image matching of towns (Dong et al., 2017)."""
