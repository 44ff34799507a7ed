"""Access control: keys, rate limits, allowed hosts and origins, and headers of replies."""

from wrenchbook.service.http.access.control import AccessControl
from wrenchbook.service.http.access.permission import Permission, permission_of
from wrenchbook.service.http.access.security import SecuritySettings

__all__ = ["AccessControl", "Permission", "SecuritySettings", "permission_of"]
