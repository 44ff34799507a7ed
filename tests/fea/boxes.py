"""Boxes of any cell kind, for tests: those of the verification suite."""

from fea.validation.boxes import box

__all__ = ["box"]
