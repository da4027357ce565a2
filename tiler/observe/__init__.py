"""Events of a run, and the listeners that show or keep them."""
