"""LAS and LAZ files: headers are checked against the file, and records are decoded in bounded pieces.

This package is below the stages because ingest and the exporter of classified clouds both read
source files. laspy names the fields of a record, and lazrs (laspy's own backend) decodes them.
The header is read here, byte for byte: its values must be possible in a file of that size, and
a classified cloud keeps bytes that laspy would rewrite.
"""
