"""Finite elements: the displacement of a component under a wrench."""

if __name__ != "wrenchbook.fea":  # a second import would copy every class and its state
    raise ImportError("import wrenchbook.fea")
