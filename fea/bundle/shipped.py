"""Where the components that come with the program are."""

from pathlib import Path

_HERE = Path(__file__).resolve()
# A wheel has them in this room, so that it puts no folder `data` among other packages; a checkout
# has them where an engineer looks for them.
_INSTALLED, _CHECKOUT = _HERE.with_name("components"), _HERE.parents[2] / "data" / "components"

SHIPPED = _INSTALLED if _INSTALLED.is_dir() else _CHECKOUT
