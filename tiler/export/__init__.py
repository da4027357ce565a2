"""Export: rasters of the store as cloud-optimised GeoTIFFs, labels as classified clouds.

Imports nothing by itself: take ``tiler.export.cog`` or ``tiler.export.classified``.
"""
