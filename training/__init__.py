"""The training workspace: torch lives here; imports `edge`, is never imported by it."""
