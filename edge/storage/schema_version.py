"""Identity of a history file: its application, its schema's version, its read views. Plain constants.

They stand apart from `schema.py`, which imports sqlite_utils and so is imported only to migrate a file.
"""

APPLICATION_ID = 0x67726E68  # "grnh", in the file's header: whose database this is
SCHEMA_VERSION = 6  # len(schema.MIGRATIONS)
USABLE_VERSION = 4  # has all that a tick needs; what comes later adds indexes, which takes long, and facts
VIEWS = (
    *("v_ticks", "v_changes", "v_decisions", "v_events", "v_ten_minutes", "v_gaps"),
    *("v_forecasts", "v_skill"),
)
