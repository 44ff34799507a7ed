"""Locks that end with their holder, and durable writes."""
