"""Logs that somebody else measured, with what is known of the truth."""
