"""Planning with a twin: its step as matrices, its state followed from tick to tick, a beam."""
