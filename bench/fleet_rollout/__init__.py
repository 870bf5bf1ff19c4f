"""A rollout of bundles in simulated fleets: boxes of the generator, each linearised about a warm state."""
