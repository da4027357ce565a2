"""What a run leaves for people and scripts to read about it."""

from tiler.report.runfile import write_run_file

__all__ = ["write_run_file"]
