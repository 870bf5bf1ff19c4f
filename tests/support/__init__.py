"""Parts that several tests and benchmarks use: broker, virtual board, daemon, page, recordings."""
