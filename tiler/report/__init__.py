"""Writes run.json and report.html, which describe a run for scripts and users."""
