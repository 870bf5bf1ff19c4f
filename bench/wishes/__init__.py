"""Sentences of operators in three languages, 32 of which refer to facts, each with what would be right."""
