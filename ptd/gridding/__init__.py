"""Surfaces other than the TIN: nearest points, inverse distances, highest returns, feet of walls, shading."""
