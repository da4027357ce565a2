"""LAS and LAZ as they lie on disk: headers checked against the file, records decoded in bounded pieces.

Below the stages, because ingest and the exporter of classified clouds both read source files.
laspy names the fields of a record, lazrs (laspy's own backend) decodes them; the header is read
here, byte for byte: what a reader believes must first be possible in a file of that size, and a
classified cloud must get back the bytes of its header that laspy would rewrite.
"""
