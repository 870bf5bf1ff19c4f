"""The web page: a process of its own that sees the rig through the control socket and the history.

It has no serial port and no model. The history is opened for reading alone, every order goes through the
control socket, and a daemon that does not answer is stopped by a file, see `edge.sockets.stop_file`. What is
kept here is who may do what, and which alarms have been acknowledged.
"""
