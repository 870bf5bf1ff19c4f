"""The library of named effects: one function and one table row each, by where they act.

`library.py` is the table, with the bounded heat that has no name yet; `named.py` holds functions and rows.
"""
