"""Surfaces beside those of the TIN: nearest points, inverse distances, highest returns, feet of walls, shading."""
