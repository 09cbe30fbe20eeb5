"""Records in windows, with alarms."""
