"""Operation of a data directory: backup, restore, doctor, retention, metrics and logs."""
