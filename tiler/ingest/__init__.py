"""Ingest of the points of source files into the store, in two steps shared by all workers.

`spool.spool_piece` decodes a piece of a file, converts it to the frame, sorts it by bucket and spools it.
`assemble.assemble_buckets` collects the points of a bucket, finds duplicates and puts the candidates first.
"""
