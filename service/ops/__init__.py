"""Operation of a data directory: backup, restore, doctor, metrics and logs."""
