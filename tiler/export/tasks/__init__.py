"""Tasks of the stage export, and what becomes of the files of earlier runs."""
