"""Boxes of any cell kind, for tests: those of the verification suite."""

from tests.validation.boxes import box

__all__ = ["box"]
