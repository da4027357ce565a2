"""Tasks of the stage export, and the archiving of outdated files of earlier runs."""
