"""Ways to learn a policy, a file each; `registry.py` has a row for each. Reward, observation and episodes
stand in the folder above and are the same for all.
"""
