"""`ridge2016`: ridge points and tested seeds for steep mountains (Remote Sensing 8(1):71, 2016)."""
