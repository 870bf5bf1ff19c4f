"""The library of named effects: one function and one table row each, by where they act.

`library.py` is the table; `air`, `heater`, `loss`, `signal` and `further` hold the functions, `unnamed` the
bounded heat that has no name yet.
"""
