"""Processes of one server: a supervisor, the builder and the web workers."""
