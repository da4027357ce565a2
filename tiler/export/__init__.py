"""Export: files for users, made from the contents of the store."""
