"""One module per command; each is imported when its command is used, and names it `command`."""
