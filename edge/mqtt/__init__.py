"""Telemetry, Home Assistant discovery and remote commands over MQTT, in threads of their own.

A message is stored before it is sent, and what comes in passes the same checks as any other request.
"""
