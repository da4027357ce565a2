"""Events of a run, and listeners that display or record them."""
