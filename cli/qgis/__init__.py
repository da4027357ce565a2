"""The plugin for QGIS, and its installation in a profile of QGIS.

`cli.qgis.plugin` runs in the Python of QGIS. It does not import other code of this project. It gets its settings from
the table that `cli.qgis.table` makes from the commands.
"""
