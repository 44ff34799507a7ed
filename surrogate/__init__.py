"""Rows in; displacement, error bar and coverage out."""

if __name__ != "wrenchbook.surrogate":  # a second copy of every class and of its state
    raise ImportError("import wrenchbook.surrogate")
