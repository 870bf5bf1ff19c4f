"""Every table, so that opening the database makes all of them. A new file of tables has a line here."""

from fleet.database import alarms, bundles, events, lease, people, rigs, twins

__all__ = ["alarms", "bundles", "events", "lease", "people", "rigs", "twins"]
