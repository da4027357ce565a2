"""Writes run.json and report.html, which describe a run for scripts and users."""

from tiler.report.runfile import write_run_file

__all__ = ["write_run_file"]
