"""A stranger's log becomes run files: what it means is guessed, written down as a mapping, then applied."""
