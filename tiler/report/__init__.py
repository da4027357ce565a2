"""What a run leaves for people and scripts to read about it."""

from tiler.report.runfile import earlier_statistics, write_run_file

__all__ = ["earlier_statistics", "write_run_file"]
