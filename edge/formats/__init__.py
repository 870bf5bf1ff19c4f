"""Every file and document that is read or written: bounded, strict, with errors that name the place.

Numbers over time, run files, profiles, YAML, JSON, and the declarative check of documents. What a file means
for the rig belongs to the room that uses it.
"""
