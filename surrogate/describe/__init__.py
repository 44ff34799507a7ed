"""Coverage and gaps in words and JSON-able values."""
