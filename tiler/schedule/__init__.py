"""Small and equal executors: here, or on Dask workers."""
