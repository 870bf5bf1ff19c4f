"""What benchmarks and tests share: broker, virtual board and daemon as processes, simulated recordings."""
