"""The lock on the access: who is let in, from where, how often, and what every reply carries."""

from wrenchbook.service.http.access.control import AccessControl
from wrenchbook.service.http.access.permission import Permission, permission_of
from wrenchbook.service.http.access.security import SecuritySettings

__all__ = ["AccessControl", "Permission", "SecuritySettings", "permission_of"]
