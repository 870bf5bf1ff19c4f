"""Does the running twin still agree with the box? A sequential test on its innovations.

Pure, once a tick. What is done when it does not, a diagnosis at night, is in `edge.app`.
"""
