"""Benchmarks; every figure of the manual is printed by one of these commands."""
