"""Everything that speaks or reads plain words: the language model, requests in words, the why of a command.

A language model is asked from threads of its own; what it proposes passes the same safety as any command.
"""
