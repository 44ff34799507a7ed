"""Check a bundle before it is solved for rows: ``python -m wrenchbook.fea.check FOLDER``.

`report` returns a description of the mesh and its supports, and every mistake in a bundle, as a
dictionary; `as_text` formats it for people. It solves for unit loads if that takes less than a
minute, to find mechanisms, the deflection and the first-order stresses.
"""

from wrenchbook.fea.check.report_text import as_text
from wrenchbook.fea.check.reporting import report

__all__ = ["as_text", "report"]
