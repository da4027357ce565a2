"""Writes run.json and report.html, which tell people and scripts about a run."""

from tiler.report.runfile import write_run_file

__all__ = ["write_run_file"]
