"""The benchmark of the diagnosis: cases with hidden effects, their truth, and how answers are scored."""
