"""Shared parts of benchmarks and tests: broker, virtual board and
daemon as processes, simulated recordings.
"""
