"""Keeping a data directory in order: pruning, backups, looking for damage and mending it."""
