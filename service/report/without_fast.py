"""Time a table's answers where numba is not found: ``python -m service.report.without_fast``."""

import sys

# Before anything is imported that would compile with it; an import of None fails as if missing.
sys.modules["numba"] = None  # type: ignore[assignment]

from service.report.timing import tell_times  # noqa: E402

if __name__ == "__main__":
    tell_times()
