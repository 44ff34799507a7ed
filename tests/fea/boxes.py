"""Boxes of any cell kind, for tests: those of the verification suite."""

from wrenchbook.fea.validation.boxes import box

__all__ = ["box"]
