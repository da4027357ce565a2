"""What the exit codes mean; errors carry their own (`tiler.errors`)."""

from __future__ import annotations

DONE = 0
USAGE = 2
PROCESSING = 4
PARTIAL = 5
INTERRUPTED = 130

EPILOG = """\b
Exit codes:
  0    done
  2    usage, configuration, or refused by the plan
  3    input that cannot be read or whose CRS cannot be used
  4    processing failed
  5    done, but files or tiles were left out, or a required check failed
  130  interrupted, by Ctrl-C or SIGTERM: the same command goes on where it was
"""
