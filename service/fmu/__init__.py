"""A component's table as an FMU: a simulator's plug-in that answers without Python or a server."""
