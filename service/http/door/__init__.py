"""The lock on the door: who is let in, from where, how often, and what every reply carries."""

from service.http.door.door import Door
from service.http.door.grant import Grant, grant_of
from service.http.door.opening import Opening

__all__ = ["Door", "Grant", "Opening", "grant_of"]
