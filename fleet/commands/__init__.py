"""The verbs of `greenhouse fleet`: each reads its arguments, calls one room and prints."""
