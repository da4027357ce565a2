"""Versions of the distribution, which hatchling reads, and of the rules of its tasks."""

__version__ = "0.1.0"

RULES = f"{__version__}-10"
"""Version of the rules of the tasks after ingest, part of their digests. Raise its last number if results or records
change within a version, so that a store of an earlier checkout is filtered and gridded again."""
INGEST_RULES = "1"
"""The same for the tasks that decode and assemble points, which take longest. Raise it only if their results change."""
