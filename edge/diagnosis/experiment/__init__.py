"""Rivals told apart: which experiment within the limits of safety makes their predictions differ most."""
