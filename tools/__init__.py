"""Commands for those who work on the project; nothing that ships imports this folder."""
