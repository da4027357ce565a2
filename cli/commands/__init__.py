"""One module per command, which defines it as `command` and is imported when the command is used."""
