"""The tests, and in `support` what they share with one another and with the benchmarks."""
