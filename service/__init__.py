"""HTTP, ledger, engines and command line."""

if __name__ != "wrenchbook.service":  # a second import would copy every class and its state
    raise ImportError("import wrenchbook.service")
