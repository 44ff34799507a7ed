"""HTTP, ledger, engines and command line."""

if __name__ != "wrenchbook.service":  # a second copy of every class and of its state
    raise ImportError("import wrenchbook.service")
