"""Search for the decks of bridges that the filter left in the terrain."""
