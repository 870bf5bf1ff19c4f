"""State that survives a restart: one list in `store.py`, one file of codecs, one writer.

Rooms below hold their values and know no file; `edge/app/` restores each value and hands changes to a writer.
Values of an installed bundle and of the history are written by their owners, but stand in the list too.
"""
