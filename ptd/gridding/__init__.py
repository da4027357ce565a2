"""Surfaces other than the TIN, sums by cell, slope and shading, and ground points next to walls."""
