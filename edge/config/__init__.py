"""The settings of the daemon: every key with its range and meaning, loading, the example file, secrets.

Whether the files and ports that the settings name exist on this machine is checked by
`edge.commands.check_config`.
"""
