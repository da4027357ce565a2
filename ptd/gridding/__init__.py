"""Surfaces beside those of the TIN (`ptd.tin`): nearest points, inverse distances, highest returns, feet of walls."""
