"""The wire protocol between host and board: messages, frames, and the host's end of the link.

Bytes and the time go in, bytes and events come out; ports are opened by `virtual_board` alone. PROTOCOL.md is
the contract, and messages.yaml the source of every message in Python and C.
"""
