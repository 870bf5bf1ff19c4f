"""A stand-in for a language model: the wire format is real, the agent behind it is a script.

Whatever table it appears in says so. It exists so that the controllers, their checks and their failures can
be run without a network and come out the same each time.
"""

MODEL = "scripted stand-in, not a language model"
