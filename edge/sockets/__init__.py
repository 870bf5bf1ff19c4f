"""Unix sockets of the daemon: the command line's way in, and the controller that is another process.

Requests are only parsed and handed on here; who answers them is decided in `edge.app.request_routes`.
"""
