"""The lock on the door: who is let in, from where, how often, and what every reply carries."""

from wrenchbook.service.http.door.door import Door
from wrenchbook.service.http.door.grant import Grant, grant_of
from wrenchbook.service.http.door.opening import Opening

__all__ = ["Door", "Grant", "Opening", "grant_of"]
