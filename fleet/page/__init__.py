"""The fleet's page and its JSON API: rigs worst first, one rig, orders, alarms, roles in groups.

Server, guard, hashes, cookie, styles and chart are those of a rig's page, `edge.page`; here is only what many
rigs add. It reads tables and numbers, sends a rig's own MQTT orders, and talks to no rig in any other way.
"""
