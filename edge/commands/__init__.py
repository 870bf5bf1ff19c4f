"""The command line: one module per command, each with `add_arguments` and `run`.

A command reads its arguments, calls one room and prints; what is worth testing by itself stands in that room.
"""
