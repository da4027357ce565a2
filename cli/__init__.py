"""The command ``tiler``: a thin shell over the library, one file per command."""
