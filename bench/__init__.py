"""Benchmarks; every figure of the manual is printed by one of these commands, or by `greenhouse-train`.

controllers  boxes/; wishes/ (a real language model); make_default_arx makes the packaged model
diagnosis    foreign/: cases with a truth; real_truth/: measured logs; reliability: what a probability means;
             drift_alarms; example_diagnosis (its runs: make_example_runs)
the rig      daemon (and the process it measures, default_daemon), outbox, kills, attack/, board_fuzz,
             page_pictures
a fleet      fleet_load, fleet_rollout/
the sources  unchanged
header is what begins a timing table. Benches that have answered their question are gone: the manual has their
figures, and commit 02ed168c their code.
"""
