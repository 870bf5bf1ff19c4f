"""The 15 input sequences (profile_*.csv); `generate` draws them, `record` runs the chamber on them."""
