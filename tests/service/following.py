"""Waiting for rows to be in use: an import is answered when they are durable."""

from tests.until import until


def wait_for_version(http, name, version, seconds=60.0):
    """Ask a component until its table's version is this one or a later one."""
    call = f"/v1/components/{name}"
    until(lambda: http.get(call).json()["table_version"] >= version, seconds)
