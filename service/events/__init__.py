"""Events for listeners: jobs that change, new versions of tables."""
