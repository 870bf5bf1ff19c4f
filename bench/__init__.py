"""Benchmarks; every figure of the manual is printed by one of these commands, or by `greenhouse-train`.

models       rollout, twin: what a forecast takes
controllers  mpc (and its plant two_node_box), clairvoyant, dqn, llm_local (a real language model; its
             llm_gguf_name, llm_from_gguf), llm_closed_loop, llm_real_server (and its llm_random_model),
             wishes/; make_default_arx makes the packaged model
diagnosis    hidden_effects/, foreign/: cases with a truth; real_truth/: measured logs; calibrate and
             reliability: what a probability means; agreement: the same answer again; resolve_alias: the
             proposed experiment; drift_alarms; example_diagnosis (its runs: make_example_runs)
the rig      daemon (and the process it measures, default_daemon), outbox, kills, attack/, history_year,
             diagnosis_memory, real_logs
the sources  mutants, house, unchanged
header is what begins a timing table; support/ is what benches and tests share.
"""
