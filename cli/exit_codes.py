"""Exit codes and their meaning. Each error class has its own code (`tiler.errors`)."""

from __future__ import annotations

DONE = 0
USAGE = 2
PROCESSING = 4
PARTIAL = 5
INTERRUPTED = 130

EPILOG = """\b
Exit codes:
  0    done
  2    wrong usage or configuration, or refused by the plan
  3    an input cannot be read, or its CRS cannot be used
  4    processing failed
  5    done, but files, parts of files or tiles were left out, or a required check failed
  130  interrupted by Ctrl-C or SIGTERM; run the same command again to resume
"""
