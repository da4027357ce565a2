"""What a run says while it works: events, and the listeners that show or keep them."""
