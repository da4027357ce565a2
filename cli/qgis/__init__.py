"""The plugin for QGIS, and what puts it into a profile of QGIS.

`cli.qgis.plugin` runs in the Python of QGIS: it imports nothing of this project and gets its settings from the table
that `cli.qgis.table` makes of the commands.
"""
