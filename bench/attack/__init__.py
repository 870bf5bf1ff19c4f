"""The whole daemon under attack: random faults, kills, floods, hostile files, evil answers, evil bundles.

Every case is drawn from a seed that is printed, so that a violation can be repeated. Each part is a module
with `run(seed, count)`; `python -m bench attack` runs all of them and prints one line a part.
"""
