"""Check a bundle before it is solved for rows: ``python -m wrenchbook.fea.check FOLDER``.

`report` says what an FEA engineer wants to know of a mesh and its supports, and every mistake in a
bundle, as a dictionary; `as_text` writes it out for people. It solves for unit loads, where that
takes less than a minute, to find mechanisms, the deflection and the first-order stresses.
"""

from wrenchbook.fea.check.report_text import as_text
from wrenchbook.fea.check.reporting import report

__all__ = ["as_text", "report"]
