"""Python imports this where it begins: `tests/conftest.py` puts the folder on PYTHONPATH."""

import machine_places  # noqa: F401
