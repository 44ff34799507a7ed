"""A component and a wrench in, a displacement out: finite elements."""

if __name__ != "wrenchbook.fea":  # a second copy of every class and of its state
    raise ImportError("import wrenchbook.fea")
