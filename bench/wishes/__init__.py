"""100 sentences of operators in three languages, each with what would be right."""
