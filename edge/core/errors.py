"""Errors that name their place. Bad weather (a lost frame, a slow network) is a value, not one of these."""


class GreenhouseError(Exception):
    """Root of every error this project raises on purpose; its text is fit for a terminal as it is."""


class ConfigError(GreenhouseError):
    """A wrong setting: `edge.yaml: safety.temp_air_max_c: 180 is above the hard limit 60`."""


class DataError(GreenhouseError):
    """A wrong run, profile or model file; the text names file, row and column."""


class RequestError(GreenhouseError):
    """A request of an operator (command line, MQTT) that can't be carried out; the text says why."""
